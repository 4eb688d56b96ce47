"""Skip `pixels`: the first iterations see images of a lower resolution, as far as their spectrum allows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Pixels(Skip):
    """By the budget's rule for pixels. Without the skip, every iteration sees all pixels."""

    order = 64

    def account(self, training: FinishedTraining) -> None:
        if training.budget.pixels is None:
            self.decide(False, "the budget has no rule for pixels")
            return
        trained = {scale: count for scale, count in training.curriculum.iterations.items() if scale > 1}
        reason = ", ".join(f"{count} iterations at 1/{scale}" for scale, count in trained.items() if count)
        left_out = sum(count * (1 - 1 / scale**2) for scale, count in trained.items())
        nothing = "the images are too small, or all of their spectrum is in their highest frequencies"
        share = left_out / max(training.log.iterations, 1)
        self.decide(bool(reason), reason or nothing, f"{share:.0%} of the pixels")

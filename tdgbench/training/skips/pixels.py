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
        steps = next(iter(training.method.models().values())).curriculum.steps
        reason = ", ".join(f"1/{scale} until iteration {last}" for last, scale in steps)
        iterations, left_out, first = max(training.log.iterations, 1), 0.0, 0
        for last, scale in steps:
            last = min(last, training.log.iterations)
            left_out += max(last - first, 0) * (1 - 1 / scale**2)
            first = max(first, last)
        nothing = "the images are too small, or all of their spectrum is in their highest frequencies"
        self.decide(bool(steps), reason or nothing, f"{left_out / iterations:.0%} of the pixels")

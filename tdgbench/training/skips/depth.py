"""Skip `depth`: depth is rendered only in iterations where its loss has an effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Depth(Skip):
    """Decided by a method with a depth loss when it is set up."""

    order = 40

    def skip_iterations(self, without: int, iterations: int, reason: str = "") -> bool:
        """Whether to skip depth in the last `without` of all iterations. reason: empty for a weight of 0."""
        start = iterations - without + 1
        return self.decide(
            without > 0,
            reason or f"the depth loss weighs nothing from iteration {start} on",
            f"depth and its loss in {without} of {iterations} iterations",
        )

    def account(self, training: FinishedTraining) -> None:
        if not self.reason:
            self.decide(False, f"{training.method.name} has no depth loss")

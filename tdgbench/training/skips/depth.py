"""Skip `depth`: depth is rendered only in iterations where its loss has an effect."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


class Depth(Skip):
    """Decided by a method with a depth loss when it is set up; what that saves depends on where training ends."""

    order = 40
    _with_depth = 0  # iterations at the start that need depth

    def skip_iterations(self, without: int, iterations: int, reason: str = "") -> bool:
        """Whether to skip depth in the last `without` of all iterations. reason: empty for a weight of 0."""
        self._with_depth = iterations - without
        reason = reason or f"the depth loss weighs nothing from iteration {self._with_depth + 1} on"
        return self.decide(without > 0, reason, _saving(without, iterations))

    def account(self, training: FinishedTraining) -> None:
        if not self.reason:
            self.decide(False, f"{training.method.name} has no depth loss")
        elif self.taken:
            trained = training.log.iterations
            without = max(0, trained - self._with_depth)
            reason = self.reason if without else f"training ended after {trained} iterations, all of which need depth"
            self.decide(without > 0, reason, _saving(without, trained))


def _saving(without: int, iterations: int) -> str:
    return f"depth and its loss in {without} of {iterations} iterations"

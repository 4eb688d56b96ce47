"""Skip `plateau`: training ends when the training views' loss, averaged over whole rounds of them, no longer falls."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt

from tdgbench.training.skips.skip import Skip

if TYPE_CHECKING:
    from tdgbench.training.skips.account import FinishedTraining


@dataclass(frozen=True)
class PlateauRule:
    """Training ends after `patience` windows in a row whose mean loss is not below the best one by `gain`.

    A window is `rounds` times all training views, so that every view has equal weight in it.
    """

    rounds: PositiveInt
    patience: PositiveInt  # windows
    gain: NonNegativeFloat  # relative
    after: NonNegativeInt  # earliest iteration


@dataclass
class Plateau:
    """Detects a plateau of the loss by a rule. views: number of training views."""

    rule: PlateauRule
    views: int
    _sum: float = 0.0
    _count: int = 0
    _best: float = field(default=float("inf"))
    _without: int = 0
    _reached: bool = False

    def state_dict(self) -> dict[str, Any]:
        """The state of the detection."""
        return {name: getattr(self, name) for name in ("_sum", "_count", "_best", "_without", "_reached")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore a state from `state_dict`."""
        vars(self).update(saved)

    def reached(self, iteration: int, loss: float) -> bool:
        """Add one iteration's loss; True from the iteration on at which training may end."""
        if self._reached:
            return True
        if iteration <= self.rule.after:
            return False
        self._sum, self._count = self._sum + loss, self._count + 1
        if self._count < self.rule.rounds * self.views:
            return False
        mean, self._sum, self._count = self._sum / self._count, 0.0, 0
        if mean < self._best * (1 - self.rule.gain):
            self._without = 0
        else:
            self._without += 1
        self._best = min(self._best, mean)
        self._reached = self._without >= self.rule.patience
        return self._reached


class PlateauSkip(Skip):
    """Skips the iterations after a plateau, if the budget has a rule."""

    order = 70

    def account(self, training: FinishedTraining) -> None:
        rule, iterations = training.budget.plateau, training.budget.iterations
        remaining = iterations - training.log.iterations
        is_asked = rule is not None and not training.curriculum.settled_at
        if rule is None:
            reason = "the budget has no plateau rule"
        elif not is_asked:
            reason = "the skip `settling` decided"
        elif remaining == 0:
            reason = "the loss went on falling"
        else:
            reason = f"the loss no longer fell by {rule.gain:.2%} a window"
        self.decide(is_asked and remaining > 0, reason, f"{remaining} of {iterations} iterations")

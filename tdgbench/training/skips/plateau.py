"""When training has stopped getting better: the loss of the training views, averaged over whole rounds of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class PlateauRule:
    """Training stops after `patience` windows in a row whose mean loss is not below the best one by `gain`.

    A window is `rounds` times all training views, so that every view counts alike in it.
    """

    rounds: int
    patience: int  # windows
    gain: float  # relative
    after: int  # not before this iteration

    def __post_init__(self) -> None:
        if self.rounds < 1 or self.patience < 1 or self.gain < 0:
            raise ValueError(f"budget.plateau needs rounds, patience ≥ 1 and gain ≥ 0, not {self}")


@dataclass
class Plateau:
    """Watches the loss by a rule."""

    rule: PlateauRule
    views: int
    _sum: float = 0.0
    _count: int = 0
    _best: float = field(default=float("inf"))
    _without: int = 0
    _reached: bool = False

    def state_dict(self) -> dict[str, Any]:
        """What was seen so far."""
        return {name: getattr(self, name) for name in ("_sum", "_count", "_best", "_without", "_reached")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take over what `state_dict` gave."""
        vars(self).update(saved)

    def reached(self, iteration: int, loss: float) -> bool:
        """Take in one iteration's loss; True once it is time to stop, and from then on."""
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

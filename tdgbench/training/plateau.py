"""A training ends when the training views' loss, averaged over whole rounds of them, no longer falls."""

from __future__ import annotations

from typing import Any

from tdgbench.training.budget import PlateauRule
from tdgbench.training.part import Stopping


class Plateau(Stopping):
    """Detects a plateau of the loss by a rule."""

    def __init__(self, rule: PlateauRule, views: int) -> None:
        """views: number of training views."""
        self.rule, self.views = rule, views
        self._sum, self._count = 0.0, 0
        self._best, self._without = float("inf"), 0
        self._reached = False

    def state_dict(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in ("_sum", "_count", "_best", "_without", "_reached")}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        vars(self).update(saved)

    def reached(self, iteration: int, loss: float) -> bool:
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

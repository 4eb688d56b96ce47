"""The rule for a plateau: end a training when its loss no longer falls."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from pydantic import NonNegativeFloat, NonNegativeInt, PositiveInt

from tdgbench.training.part import State, Stopping
from tdgbench.training.rule import Rule, Watched
from tdgbench.training.skips import Finished, Skip


@dataclass(frozen=True)
class PlateauRule(Rule):
    """End a training after `patience` windows in a row whose mean loss is not below the best one by `gain`.

    A window is `epochs` rounds of all training views, so that every view has equal weight in it; rounds begin with the
    stage, whose steps take a view each.
    """

    ends_training = True

    epochs: PositiveInt
    patience: PositiveInt  # windows
    gain: NonNegativeFloat  # relative
    after: NonNegativeInt  # earliest iteration

    def stopping(self, stage: Watched) -> Stopping:
        return Plateau(self, stage.views)

    def account(self, skip: Skip, training: Finished) -> None:
        is_asked = not any(curriculum.settled_at for curriculum, _ in training.curricula)
        if not is_asked:
            reason = "the rule for settling decided"
        elif not training.reached_plateau:
            reason = "the loss went on falling, or there were too few iterations to tell"
        else:
            reason = f"the loss no longer fell by {self.gain:.2%} a window"
        skip.decide(is_asked and training.reached_plateau and training.remaining > 0, reason, training.left_out)


class Plateau(Stopping):
    """Detects a plateau of the loss by a rule. On a GPU, the device adds the losses up; the host reads their sums."""

    reads_loss = False
    changing = ("_sum", "_count", "_best", "_without", "_reached")

    def __init__(self, rule: PlateauRule, views: int) -> None:
        """views: number of training views."""
        self.rule, self.views = rule, views
        self._sum: float | torch.Tensor = 0.0
        self._count = 0
        self._best, self._without = float("inf"), 0
        self._reached = False

    @property
    def is_flat(self) -> bool:
        """Whether the loss has reached a plateau."""
        return self._reached

    def state_dict(self) -> State:
        return {**super().state_dict(), "_sum": float(self._sum)}

    def reached(self, iteration: int, loss: float | torch.Tensor) -> bool:
        if self._reached:
            return True
        if iteration <= self.rule.after or (self._count == 0 and (iteration - 1) % self.views):  # within a round
            return False
        self._sum, self._count = self._sum + loss, self._count + 1
        if self._count < self.rule.epochs * self.views:
            return False
        mean, self._sum, self._count = float(self._sum) / self._count, 0.0, 0
        if mean < self._best * (1 - self.rule.gain):
            self._without = 0
        else:
            self._without += 1
        self._best = min(self._best, mean)
        self._reached = self._without >= self.rule.patience
        return self._reached

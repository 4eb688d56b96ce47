"""Reasons and savings of skips after training."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from tdgbench.scenes import Scene
    from tdgbench.training.budget import Budget
    from tdgbench.training.curriculum import Curriculum
    from tdgbench.training.loop import TrainingLog
    from tdgbench.training.method import Method
    from tdgbench.training.model import Work
    from tdgbench.training.skips.registry import Skips


class FinishedTraining(NamedTuple):
    """What skips account for."""

    scene: Scene
    method: Method
    budget: Budget
    log: TrainingLog

    @property
    def curriculum(self) -> Curriculum:
        """Of all the method's models."""
        return next(iter(self.method.models().values())).curriculum

    @property
    def work(self) -> list[Work]:
        """The work of each of the method's models."""
        return [model.work for model in self.method.models().values()]


def note_training(skips: Skips, scene: Scene, method: Method, budget: Budget, log: TrainingLog) -> None:
    """Write reasons and savings of a training into its skips."""
    training = FinishedTraining(scene, method, budget, log)
    for skip in skips.all():
        skip.account(training)

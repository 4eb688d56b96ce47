"""The rules of a budget: what a training decides from its scene. Each is one file, and one field of `Budget`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from torch import Tensor

from tdgbench.scenes import Camera, Scene, View
from tdgbench.splats import Gaussians
from tdgbench.splats.density import GrowthDecision
from tdgbench.splats.view import Pinhole
from tdgbench.training.curriculum import Curriculum, Resolution
from tdgbench.training.images import Modality
from tdgbench.training.part import Part, Stopping
from tdgbench.training.skips import Finished, Skip

BudgetFields = Mapping[str, Any]  # values of `tdgbench.training.budget.Budget` by name
DecideGrowth = Callable[[Gaussians, int, int], GrowthDecision]  # of Gaussians, the SH degree in use, the round's number


class ModelInputs(NamedTuple):
    """What a model is trained on."""

    views: list[View]  # training views
    images: Modality
    curriculum: Curriculum
    backend: str
    background: Tensor | None = None  # (C,) behind the Gaussians; None: black
    camera_of: Callable[[Camera], Camera] = lambda camera: camera  # the camera that took a view's image, of the view's


class Watched(NamedTuple):
    """A stage that a rule may end; where rules watch modalities, its models of one."""

    iterations: int  # of the stage's budget
    views: int  # training views
    curriculum: Curriculum
    parts: Mapping[str, Part]
    psnr_of: Callable[[View], float]  # of a render of a view at full resolution, dB


class Rule:
    """A rule of a budget: a frozen dataclass of options, which are those of its YAML. It is off where it is null.

    A training asks every rule that is on through the methods below; a rule overrides those that it answers. A finished
    cell is rendered without rules, from what its training left.
    """

    is_skip: ClassVar[bool] = True  # records list it among the skips, as `account` says
    ends_training: ClassVar[bool] = False  # a training may end before its last iteration
    watches_modalities: ClassVar[bool] = False  # models of each modality have a curriculum, else those of a stage

    def held_out(self, views: list[View]) -> list[View]:
        """Return training views that a training does not train on at first."""
        return []

    def resolutions(self, views: list[View], images: Modality, gaussians: int, iterations: int) -> list[Resolution]:
        """Return the resolutions below the full one that a training begins with, for models of a modality.

        views: training views. gaussians: their number at the start. iterations: of the stage.
        """
        return []

    def kept_points(self, points: np.ndarray, views: Sequence[View], images: Modality) -> np.ndarray | None:
        """Return with which of the measured points (N, 3) models of a modality begin, (N,) bool; None: with all.

        views: training views. The first rule that returns some decides.
        """
        return None

    def adaptation(self, scene: Scene, images: Modality) -> Callable[[BudgetFields], BudgetFields]:
        """Return a function from the budget of models of a modality to what they train with instead; nothing here."""
        return lambda budget: {}

    def growth(self, model: ModelInputs) -> DecideGrowth | None:
        """Return the function that decides which Gaussians of a model grow; None: density control's threshold does."""
        return None

    def stopping(self, stage: Watched) -> Stopping | None:
        """Return what may end a stage early. The first rule that returns one decides."""
        return None

    def warm_up(self, gaussians: Gaussians, camera: Pinhole, backend: str) -> None:
        """Run the kernels that the rule alone needs, so that they are compiled before the clock starts."""

    def account(self, skip: Skip, training: Finished) -> None:
        """Decide the rule's skip of a finished training: whether work was left out, why, and how much."""

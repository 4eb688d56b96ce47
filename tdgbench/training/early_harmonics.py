"""The rule for harmonics: learn them sooner where noise is low and all views see a point from nearly one direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt

from tdgbench.scenes import Camera, Scene
from tdgbench.training.curriculum import evenly_spread
from tdgbench.training.images import Modality
from tdgbench.training.rule import BudgetFields, Rule

MOST_VIEWS = 8  # whose noise is measured
_MOST_POINTS = 2000


@dataclass(frozen=True)
class HarmonicsRule(Rule):
    """Raise the SH degree sooner where images have little noise and cameras see each point from nearly one direction.

    Harmonics learn noise as well. Around an orbit they also learn to hide a Gaussian from the training views, when it
    stands near a camera between them.
    """

    is_skip = False

    every: PositiveInt  # iterations after which the degree rises by one, if the budget's `sh_every` is larger
    gain: PositiveFloat  # dB, if that of `SettlingRule` is larger: a degree raises the PSNR some checks later
    most_noise: NonNegativeFloat  # standard deviation, of an image's values in [0, 1]
    most_angle: Annotated[float, Field(ge=0, le=180)]  # degrees, between directions from which a point is seen

    def adaptation(self, scene: Scene, images: Modality) -> Callable[[BudgetFields], BudgetFields]:
        return self._sooner if self.applies(scene, images) else super().adaptation(scene, images)

    def applies(self, scene: Scene, images: Modality) -> bool:
        """Return whether harmonics are learned sooner from the training images of a modality.

        That needs measured points: the scene's sparse ones, whatever the initial ones are.
        """
        if scene.points is None:
            return False
        noise = images.typical_noise(evenly_spread(scene.train, min(MOST_VIEWS, len(scene.train))))
        cameras = [view.camera for view in scene.train]
        return noise <= self.most_noise and viewing_angle(scene.points.points, cameras) <= self.most_angle

    def _sooner(self, budget: BudgetFields) -> BudgetFields:
        if budget["sh_degree"] == 0:
            return {}
        settling = budget["settling"]
        if settling is not None:
            settling = replace(settling, gain=min(settling.gain, self.gain))
        return {"sh_every": min(budget["sh_every"], self.every), "settling": settling}


def viewing_angle(points: np.ndarray, cameras: Sequence[Camera]) -> float:
    """Return how far directions from which cameras see a point (N, 3) are from their mean: degrees.

    The root mean square over the cameras that have it in their frame, at least two; median over the points. Infinite if
    there are none.
    """
    points = points[:: max(1, -(-len(points) // _MOST_POINTS))]
    total, count = np.zeros_like(points, dtype=np.float64), np.zeros(len(points))
    for camera in cameras:
        seen = camera.shows(points)
        directions = points[seen] - camera.center
        total[seen] += directions / np.linalg.norm(directions, axis=1, keepdims=True)
        count += seen
    known = count > 1
    if not known.any():
        return np.inf
    resultant = np.linalg.norm(total[known], axis=1) / count[known]
    return float(np.degrees(np.sqrt(2 * np.clip(1 - np.median(resultant), 0, 1))))

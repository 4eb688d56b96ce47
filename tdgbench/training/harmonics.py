"""Where harmonics can be learned soon: little noise, and points that all views see from nearly the same direction."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tdgbench.scenes import Camera, View
from tdgbench.training.budget import HarmonicsRule
from tdgbench.training.images import Modality
from tdgbench.training.spectrum import typical_noise
from tdgbench.training.stopping import spread

MOST_VIEWS = 8  # whose noise is measured
MOST_POINTS = 2000


def are_learned_soon(rule: HarmonicsRule, views: list[View], modality: Modality, points: np.ndarray) -> bool:
    """Return whether a rule applies to training views of sparse points (N, 3)."""
    some = spread(views, min(MOST_VIEWS, len(views)))
    noise = typical_noise((modality.array(view), modality.valid(view)) for view in some)
    return noise <= rule.most_noise and viewing_angle(points, [view.camera for view in views]) <= rule.most_angle


def viewing_angle(points: np.ndarray, cameras: Sequence[Camera]) -> float:
    """Return how far directions from which cameras see a point (N, 3) are from their mean: degrees.

    The root mean square over the cameras that have it in their frame, at least two; median over the points. Infinite if
    there are none.
    """
    points = points[:: max(1, -(-len(points) // MOST_POINTS))]
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

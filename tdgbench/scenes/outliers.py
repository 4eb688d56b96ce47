"""Cameras whose pose must be wrong, by where they stand and what they see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.camera import Camera

SAMPLE = 2000  # points
FEWEST = 5  # cameras of which one can be outlying
MOST = 0.1  # of the cameras that can be
FAR, FAR_WITHOUT_POINTS = 10, 100  # × the distance from the middle within which all but MOST cameras stand
DOT = 0.02  # of the image's diagonal; what is further apart is seen


class Sight(NamedTuple):
    """What V cameras see of P points."""

    seen: np.ndarray  # (V, P) bool
    z: np.ndarray  # (V, P) float32, world units


def outlying(cameras: Sequence[Camera], points: np.ndarray | None = None) -> np.ndarray:
    """Return which cameras stand so far from all others that their pose must be wrong, (V,) bool.

    Such a camera is `FAR` times as far from the middle as nine of ten, and all points (N, 3) that two others see lie
    outside its image or in one dot of it; without points, it is `FAR_WITHOUT_POINTS` times as far. So walks, flights,
    groups apart and overviews are not outlying.
    """
    found = np.zeros(len(cameras), bool)
    if len(cameras) < FEWEST:
        return found
    distances = from_middle(cameras)
    reach = np.sort(distances)[int((1 - MOST) * (len(cameras) - 1))]
    far = distances > FAR * reach
    if reach == 0 or not far.any():
        return found
    sample = sample_of(points, 5 * SAMPLE)
    if not len(sample):
        return distances > FAR_WITHOUT_POINTS * reach
    shown = np.array([camera.shows(sample) for camera in cameras])
    of_three = shown.sum(axis=0) > 2
    for index in np.flatnonzero(far).tolist():
        camera = cameras[index]
        pixels, _ = camera.project(sample[shown[index] & of_three])
        size = 0.0 if not len(pixels) else float(np.ptp(pixels, axis=0).max())
        found[index] = size < DOT * math.hypot(camera.width, camera.height)
    return found


def sight_of(cameras: Sequence[Camera], points: np.ndarray) -> Sight:
    seen, depths = np.empty((len(cameras), len(points)), bool), np.empty((len(cameras), len(points)), np.float32)
    for index, camera in enumerate(cameras):
        pixels, z = camera.project(points)
        seen[index], depths[index] = camera.holds(pixels, z), z
    return Sight(seen, depths)


def sample_of(points: np.ndarray | None, most: int = SAMPLE) -> np.ndarray:
    """Return up to `most` of the points (N, 3), drawn at random: files may have an order."""
    if points is None or len(points) <= most:
        return np.zeros((0, 3)) if points is None else points
    return points[np.random.default_rng(0).choice(len(points), most, replace=False)]


def from_middle(cameras: Sequence[Camera]) -> np.ndarray:
    """Return distances (V,) of the cameras from the median of their positions."""
    centers = centers_of(cameras)
    distances: np.ndarray = np.linalg.norm(centers - np.median(centers, axis=0), axis=1)
    return distances


def centers_of(cameras: Sequence[Camera]) -> np.ndarray:
    return np.stack([camera.center for camera in cameras])

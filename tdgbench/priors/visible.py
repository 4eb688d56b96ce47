"""Sparse points that a camera sees."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter

from tdgbench.scenes import Camera

WINDOW = 5  # cells; side of the square in which nearer points hide others
POINTS_IN_WINDOW = 4  # that should lie in that square
GRID = (24, 160)  # fewest and most columns of a grid in which points hide others


class VisiblePoints(NamedTuple):
    """Points by the pixel of a camera in which they lie; all arrays have shape (N,)."""

    number: np.ndarray  # among the given points
    rows: np.ndarray
    columns: np.ndarray
    z: np.ndarray  # world units


def visible_points(camera: Camera, points: np.ndarray, occlusion: float) -> VisiblePoints:
    """Return the points (N, 3) inside the image that no other hides.

    A point is hidden if it lies more than the share `occlusion` behind the nearest one within 2 px. Points are sparse:
    use the camera of a small image (`camera.resized`).

    >>> camera = Camera(np.diag([8.0, 8.0, 1.0]), np.eye(4), width=8, height=8)
    >>> visible_points(camera, np.array([[0.5, 0.5, 1.0], [1.0, 1.0, 2.0], [-1.0, 0.0, 1.0]]), 0.1).z.tolist()
    [1.0]
    """
    pixels, z = camera.project(points)
    index = np.flatnonzero(_is_inside(camera, pixels, z))
    columns, rows = pixels[index].astype(int).T
    z = z[index]
    nearest = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(nearest, (rows, columns), z)
    seen = z <= minimum_filter(nearest, size=WINDOW)[rows, columns] * (1 + occlusion)
    return VisiblePoints(index[seen], rows[seen], columns[seen], z[seen])


def grid_width(cameras: Sequence[Camera], points: np.ndarray) -> int:
    """Return columns of a small image in which about POINTS_IN_WINDOW of the points (N, 3) in it share a window."""
    inside = sum(int(np.count_nonzero(_is_inside(camera, *camera.project(points)))) for camera in cameras)
    cells = WINDOW**2 * inside / len(cameras) / POINTS_IN_WINDOW
    return int(np.clip(np.sqrt(cells * cameras[0].width / cameras[0].height), *GRID))


def _is_inside(camera: Camera, pixels: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return which projected points, at pixels (N, 2) and z (N,), lie in the image."""
    size = (camera.width, camera.height)
    return np.asarray((z > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1))

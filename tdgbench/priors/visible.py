"""Sparse points that a camera sees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import minimum_filter

from tdgbench.scenes import Camera

WINDOW = 5  # cells; side of the square in which nearer points hide others


class VisiblePoints(NamedTuple):
    """Points by the pixel of a camera in which they lie; all arrays have shape (N,)."""

    number: np.ndarray  # among the given points
    rows: np.ndarray
    columns: np.ndarray
    z: np.ndarray  # world units


def visible_points(camera: Camera, points: np.ndarray, occlusion: float) -> VisiblePoints:
    """The points (N, 3) inside the image that no other hides.

    A point is hidden if it lies more than the share `occlusion` behind the nearest one within 2 px. Points are sparse:
    use the camera of a small image (`camera.resized`).

    >>> camera = Camera(np.diag([8.0, 8.0, 1.0]), np.eye(4), width=8, height=8)
    >>> visible_points(camera, np.array([[0.5, 0.5, 1.0], [1.0, 1.0, 2.0], [-1.0, 0.0, 1.0]]), 0.1).z.tolist()
    [1.0]
    """
    pixels, z = camera.project(points)
    inside = (z > 0) & (pixels >= 0).all(axis=1) & (pixels[:, 0] < camera.width) & (pixels[:, 1] < camera.height)
    index = np.flatnonzero(inside)
    columns, rows = pixels[index].astype(int).T
    z = z[index]
    nearest = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(nearest, (rows, columns), z)
    seen = z <= minimum_filter(nearest, size=WINDOW)[rows, columns] * (1 + occlusion)
    return VisiblePoints(index[seen], rows[seen], columns[seen], z[seen])

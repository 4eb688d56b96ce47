"""Known depth in views: true depth of built-in scenes, else the sparse points of structure from motion.

Every second point is the truth. A prior that is made from points gets the others: none is judged by what it was made
from.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tdgbench.priors.visible import visible_points
from tdgbench.scenes import PointCloud, Scene, View

GRID_WIDTH = 160  # columns of the grid on which points hide others, as in conf/prior/sfm_points.yaml
OCCLUSION = 0.1  # as there
MIN_POINTS = 20  # of a view that is judged


class KnownDepth(NamedTuple):
    """True z at pixels; all arrays have shape (N,)."""

    rows: np.ndarray
    columns: np.ndarray
    z: np.ndarray  # world units


def source(scene: Scene) -> str:
    """What is known of a scene's depth; empty if nothing is."""
    if all(view.true_depth_path is not None for view in scene.train):
        return "true depth"
    return "" if scene.points is None else "SfM points"


def halves(scene: Scene) -> tuple[Scene, np.ndarray]:
    """The scene with every second sparse point, and the other points (N, 3)."""
    if scene.points is None:
        return scene, np.zeros((0, 3))
    given = PointCloud(scene.points.points[::2], scene.points.colors[::2])
    return replace(scene, points=given, fingerprint=f"{scene.fingerprint}-half"), scene.points.points[1::2]


def known_depth(view: View, points: np.ndarray) -> KnownDepth | None:
    """Known depth in a view's measured pixels; None where that is less than MIN_POINTS. points: (N, 3), the truth."""
    known = _of_points(view, points) if view.true_depth is None else _of_map(view.true_depth)
    valid = view.valid
    if valid is not None:
        known = KnownDepth(*(one[valid[known.rows, known.columns]] for one in known))
    return known if len(known.z) >= MIN_POINTS else None


def _of_map(depth: np.ndarray) -> KnownDepth:
    rows, columns = np.nonzero(depth > 0)
    return KnownDepth(rows, columns, depth[rows, columns].astype(np.float64))


def _of_points(view: View, points: np.ndarray) -> KnownDepth:
    camera = view.camera
    width = min(GRID_WIDTH, camera.width)
    grid = camera.resized(width, max(1, round(camera.height * width / camera.width)))
    seen = visible_points(grid, points, OCCLUSION)
    columns, rows = camera.project(points[seen.number])[0].astype(int).T
    inside = (columns < camera.width) & (rows < camera.height)
    return KnownDepth(rows[inside], columns[inside], seen.z[inside])

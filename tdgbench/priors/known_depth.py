"""Known depth in a view's pixels, of the truth or of sparse points, and doubts about priors that contradict it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr

from tdgbench.priors.prior import DepthPrior
from tdgbench.priors.sfm_points import visible_points
from tdgbench.scenes import Scene, View

GRID_WIDTH = 160  # columns of the grid on which points hide others, as in conf/prior/sfm_points.yaml
_OCCLUSION = 0.1  # as there
MOST_POINTS = 20_000  # that priors are compared with
FEWEST_POINTS = 20  # in a view that is compared
LEAST_RANK = 0.2  # of maps that are not doubted: Spearman's correlation with depth, median of the views
LARGEST_RATIO = 3.0  # of a metric map's depth and that of points, median of the views


class KnownDepth(NamedTuple):
    """True z at pixels; all arrays have shape (N,)."""

    rows: np.ndarray
    columns: np.ndarray
    z: np.ndarray  # world units


def known_depth(view: View, points: np.ndarray) -> KnownDepth:
    """Return the known depth in a view's measured pixels. points: (N, 3), the truth."""
    depth, valid = view.true_depth, view.valid
    if depth is None:
        known = _of_points(view, points)
    else:
        rows, columns = np.nonzero(depth > 0)
        known = KnownDepth(rows, columns, depth[rows, columns].astype(np.float64))
    if valid is not None:
        known = KnownDepth(*(array[valid[known.rows, known.columns]] for array in known))
    return known


def _of_points(view: View, points: np.ndarray) -> KnownDepth:
    camera = view.camera
    width = min(GRID_WIDTH, camera.width)
    grid = camera.resized(width, max(1, round(camera.height * width / camera.width)))
    seen = visible_points(grid, points, _OCCLUSION)
    columns, rows = camera.project(points[seen.number])[0].astype(int).T
    inside = (columns < camera.width) & (rows < camera.height)
    return KnownDepth(rows[inside], columns[inside], seen.z[inside])


def doubts_of(priors: Mapping[str, DepthPrior], scene: Scene) -> Iterator[str]:
    """Yield why the priors of a scene's training views may be wrong, by its sparse points; nothing where it has few."""
    ranks, ratios = list[float](), list[float]()
    points = np.zeros((0, 3)) if scene.points is None else scene.points.points
    for view in scene.train:
        known = _of_points(view, points[:: len(points) // MOST_POINTS + 1])
        values = priors[view.name].values[known.rows, known.columns]
        z, values = known.z[np.isfinite(values)], values[np.isfinite(values)]
        if len(z) >= FEWEST_POINTS and np.ptp(values) > 0 and np.ptp(z) > 0:
            ranks.append(float(spearmanr(values, z).statistic))
            ratios.append(float(np.median(values / z)))
    if not ranks:
        return
    kind = priors[scene.train[0].name].kind
    rank, ratio = float(np.median(ranks)) * (-1 if kind == "disparity" else 1), float(np.median(ratios))
    where = f"of the sparse points (median of {len(ranks)} views)"
    if rank < LEAST_RANK:
        yield (
            f"the depth prior, of kind {kind}, has a rank correlation of {rank:.2f} with the depth {where}: are its "
            "kind, its files' names and its orientation right?"
        )
    elif kind == "metric" and not 1 / LARGEST_RATIO <= ratio <= LARGEST_RATIO:
        yield f"the depth prior, of kind metric, is {ratio:.3g} × the depth {where}: is it in the scene's units?"

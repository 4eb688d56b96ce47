"""Depth in world units from priors that have none: scale and shift per view, from sparse points (Chung et al. 2024)."""

from __future__ import annotations

import numpy as np

from tdgbench.priors import DepthPrior, PriorError
from tdgbench.priors.sfm_points import grid_width, visible_points
from tdgbench.scenes import Camera, Scene

PRUNED = 0.001  # share of the depths that is left out at either end
PENALTY = 2.0  # of depths that are not positive
ROUNDS = 50
MIN_POINTS = 4
NORMAL_MEDIAN = 1.4826  # standard deviation of normal errors / the median of their absolute values
FARTHEST = 2.0  # × the farthest point's depth: an inverted disparity is unknown beyond


def metric_depths(scene: Scene, priors: dict[str, DepthPrior], occlusion: float | None = None) -> dict[str, DepthPrior]:
    """Return the depth (z, world units) of each training view by name, NaN where its prior is unknown.

    A metric prior is returned as it is, the others are aligned to the scene's sparse points. occlusion: without points
    that lie more than this share behind others (`visible_points`); None: to all, as released. Raises PriorError.
    """
    return {view.name: _metric(scene, priors[view.name], view.camera, view.name, occlusion) for view in scene.train}


def _metric(scene: Scene, prior: DepthPrior, camera: Camera, name: str, occlusion: float | None) -> DepthPrior:
    if prior.kind == "metric":
        return prior
    if scene.points is None or not len(scene.points.points):
        raise PriorError(
            f"{scene.name} has no sparse points, to which the {prior.kind} prior of view {name} could be aligned; give "
            "depth in world units: prior=files prior.estimator.kind=metric prior.estimator.folder=DIR"
        )
    source = prior.values.astype(np.float64)
    target = sparse_depths(_seen_points(scene.points.points, camera, occlusion), camera)
    found = (target > 0) & np.isfinite(source)
    if np.count_nonzero(found) < MIN_POINTS:
        raise PriorError(
            f"view {name} of {scene.name} sees sparse points in {np.count_nonzero(found)} pixels with a depth prior; "
            f"aligning it needs {MIN_POINTS}: leave out the view, or raise data.width if its image is small"
        )
    if prior.kind == "disparity":
        source = inverted(source, target, found)
        found &= np.isfinite(source)
    scale, shift = fit(source[found], target[found])
    return DepthPrior((scale * source + shift).astype(np.float32), "metric")


def deviation(scene: Scene, depth: DepthPrior, camera: Camera, occlusion: float | None = None) -> float:
    """Return the standard deviation of a metric prior from the scene's sparse points, world units, by its median.

    1.4826 × the median of |prior − point|, which of normal errors is their standard deviation. It is 0 where fewer than
    MIN_POINTS are in pixels with a prior. occlusion: see `metric_depths`.
    """
    if scene.points is None or not len(scene.points.points):
        return 0.0
    target = sparse_depths(_seen_points(scene.points.points, camera, occlusion), camera)
    found = (target > 0) & np.isfinite(depth.values)
    if np.count_nonzero(found) < MIN_POINTS:
        return 0.0
    return float(NORMAL_MEDIAN * np.median(np.abs(depth.values[found] - target[found])))


def _seen_points(points: np.ndarray, camera: Camera, occlusion: float | None) -> np.ndarray:
    """Return the points (N, 3) without those behind others by more than a share of their depth; None: all."""
    if occlusion is None:
        return points
    width = min(grid_width([camera], points), camera.width)
    small = camera.resized(width, max(1, round(camera.height * width / camera.width)))
    return points[visible_points(small, points, occlusion).number]


def sparse_depths(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Return the z (H, W), world units, of the last of points (N, 3) in each pixel; 0: there is none.

    The authors leave out points that fewer than two training views see, and weight the others by their reprojection
    errors; a scene's points have neither views nor errors here.
    """
    pixels, z = camera.project(points)
    inside = camera.holds(pixels, z)
    columns, rows = pixels[inside].astype(int).T
    depths = np.zeros((camera.height, camera.width))
    depths[rows, columns] = z[inside]
    return depths


def inverted(disparity: np.ndarray, target: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return depth (H, W) from an affine-invariant disparity, whose line is fitted to 1 / target where `found`.

    It is NaN where the line is beyond FARTHEST of the targets: the inverse says nothing there.
    """
    columns = np.stack([disparity[found], np.ones(int(found.sum()))], axis=1)
    scale, shift = np.linalg.lstsq(columns, 1 / target[found], rcond=None)[0]
    inverse = scale * disparity + shift
    near = inverse > 1 / (FARTHEST * target[found].max())
    return np.divide(1.0, inverse, out=np.full_like(inverse, np.nan), where=near)


def fit(source: np.ndarray, target: np.ndarray, weights: np.ndarray | None = None) -> tuple[float, float]:
    """Return scale and shift that take `source` (N,) to `target` (N,), positive numbers; weights (N,): by default 1.

    Minimises  mean w (target − line)² + 2 mean over the line's values below zero of line²  (`optimize_depth` of the
    authors, who descend by Adam), by least squares whose second set is found anew until it stays.

    >>> scale, shift = fit(np.arange(8.0), 2 * np.arange(8.0) + 3)
    >>> round(scale, 6), round(shift, 6)
    (2.0, 3.0)
    """
    order = np.sort(target)
    last = len(order) - 1
    low, high = (order[min(int(len(order) * share), last)] for share in (PRUNED, 1.0 - PRUNED))
    kept = (target > low) & (target < high)
    kept = kept if np.count_nonzero(kept) >= MIN_POINTS else np.ones_like(kept)  # theirs always leave out two
    columns = np.stack([source[kept], np.ones(int(kept.sum()))], axis=1)
    wanted, weight = target[kept], (np.ones_like(target) if weights is None else weights)[kept]
    negative, best = np.zeros(len(wanted), bool), (np.inf, (0.0, 0.0))
    for _ in range(ROUNDS):
        share = weight / len(weight)
        penalty = PENALTY * negative / max(int(negative.sum()), 1)
        matrix = np.concatenate([columns * np.sqrt(share)[:, None], columns * np.sqrt(penalty)[:, None]])
        line = np.linalg.lstsq(matrix, np.concatenate([wanted * np.sqrt(share), np.zeros(len(wanted))]), rcond=None)[0]
        values = columns @ line
        now = values <= 0
        loss = float((share * (wanted - values) ** 2).sum())
        loss += PENALTY * float(np.square(values[now]).mean()) if now.any() else 0.0
        best = min(best, (loss, (float(line[0]), float(line[1]))))
        if np.array_equal(now, negative):
            break
        negative = now
    return best[1]

"""Error of a depth prior against known depth, after the alignment that its kind needs.

AbsRel and δ are those of Eigen et al. 2014 (NIPS, "Depth Map Prediction from a Single Image using a Multi-Scale Deep
Network"). Scale and shift are fitted by least squares per view: of disparities to 1/z as for MiDaS (Ranftl et al. 2020,
section 5), of affine-invariant depths to z as for Marigold (Ke et al. 2024, section 4). Metric depths are scaled by the
ratio of medians (Zhou et al. 2017), since the unit of a COLMAP model is arbitrary.

A synthetic scene's depth is known at each pixel. Of another scene, the depth of every second sparse point of structure
from motion counts as known; a prior that is made from points gets the other half, so that it is not judged by its own.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig
from scipy.stats import spearmanr

from tdgbench.cells.prior_sources import POINTS
from tdgbench.priors import DepthPrior, PriorError, estimate_all, prepare
from tdgbench.priors.known_depth import KnownDepth, known_depth
from tdgbench.priors.prior import Kind
from tdgbench.scenes import PointCloud, Scene

DELTA = 1.25
_MIN_POINTS = 20  # of a view that is judged


class Accuracy(NamedTuple):
    """Error of one map, or means over maps."""

    abs_rel: float  # mean of |z − z_true| / z_true
    delta: float  # share of pixels with max(z / z_true, z_true / z) < 1.25
    rank: float  # Spearman's rank correlation with depth, in [−1, 1]; needs no alignment


class PriorErrors(NamedTuple):
    """A prior on a scene. views: its error by training view; those that show too little known depth are left out."""

    kind: str = ""
    views: dict[str, Accuracy] = {}  # noqa: RUF012 (never changed)
    reason: str = ""  # why there is no prior; then the rest is empty

    @property
    def mean(self) -> Accuracy:
        """Means of the errors over the views; NaN without any."""
        errors = list(self.views.values()) or [Accuracy(np.nan, np.nan, np.nan)]
        return Accuracy(*map(float, np.mean(errors, axis=0)))


def measure_prior(prior: DictConfig, scene: Scene, cache: Path | None) -> PriorErrors:
    """Measure the error of a prior, configured as in `conf/prior/`, on a scene. cache: see `estimate_all`."""
    given, points = split_points(scene)
    try:
        estimator = instantiate(prior.estimator)
        prepare(estimator)
        maps, _ = estimate_all(estimator, given if prior.get("made_from") == POINTS else scene, cache)
    except PriorError as error:
        return PriorErrors(reason=str(error).splitlines()[0])
    kind = next(iter(maps.values())).kind
    if not source(scene):
        return PriorErrors(kind)
    by_view = {view.name: _of_view(maps[view.name], known_depth(view, points)) for view in scene.train}
    return PriorErrors(kind, {name: error for name, error in by_view.items() if error is not None})


def _of_view(prior: DepthPrior, known: KnownDepth) -> Accuracy | None:
    """Return the error of a map where depth is known and the prior is finite; None where that is too little."""
    values = prior.values[known.rows, known.columns]
    finite = np.isfinite(values)
    return accuracy(values[finite], prior.kind, known.z[finite]) if finite.sum() >= _MIN_POINTS else None


def source(scene: Scene) -> str:
    """Name what is known of a scene's depth; empty if nothing is."""
    if all(view.load_true_depth is not None for view in scene.train):
        return "true depth"
    return "" if scene.points is None else "SfM points"


def split_points(scene: Scene) -> tuple[Scene, np.ndarray]:
    """Return the scene with every second sparse point, and the other points (N, 3)."""
    if scene.points is None:
        return scene, np.zeros((0, 3))
    given = PointCloud(scene.points.points[::2], scene.points.colors[::2])
    return replace(scene, points=given, fingerprint=f"{scene.fingerprint}-half"), scene.points.points[1::2]


def accuracy(values: np.ndarray, kind: Kind, truth: np.ndarray) -> Accuracy:
    """Return the accuracy of prior values (N,) against true z (N,), both finite, z > 0.

    >>> z = np.array([1.0, 2.0, 4.0])
    >>> [round(number, 6) for number in accuracy(3 / z - 7, "disparity", z)]
    [0.0, 1.0, 1.0]
    """
    depth = aligned(values.astype(np.float64), kind, truth)
    ratio = np.maximum(depth / truth, truth / depth)
    sign = -1.0 if kind == "disparity" else 1.0
    return Accuracy(
        float((np.abs(depth - truth) / truth).mean()),
        float((ratio < DELTA).mean()),
        sign * float(spearmanr(values, truth).statistic) if np.ptp(values) > 0 and np.ptp(truth) > 0 else np.nan,
    )


def aligned(values: np.ndarray, kind: Kind, truth: np.ndarray) -> np.ndarray:
    """Return the depths z (N,) that fit the truth (N,) best, within the truth's range (MiDaS clips to the data set's).

    >>> aligned(np.array([1.0, 2.0, 4.0]), "metric", np.array([2.0, 4.0, 6.0])).tolist()
    [2.0, 4.0, 6.0]
    """
    if kind == "metric":
        depth = values * (np.median(truth) / np.median(values))
    elif kind == "depth":
        depth = _fitted(values, truth)
    else:
        inverse = np.clip(_fitted(values, 1 / truth), 1 / truth.max(), 1 / truth.min())
        depth = 1 / inverse
    return np.clip(depth, truth.min(), truth.max())


def _fitted(values: np.ndarray, target: np.ndarray) -> np.ndarray:
    """s · values + t with the s and t that minimise the squared distance to the target; a negative s is allowed."""
    terms = np.column_stack([values, np.ones_like(values)])
    scale, shift = np.linalg.lstsq(terms, target, rcond=None)[0]
    return scale * values + shift

"""Error of a depth prior against known depth, after the alignment that its kind needs.

AbsRel and δ are those of Eigen et al. 2014 (NIPS, "Depth Map Prediction from a Single Image using a Multi-Scale Deep
Network"). Scale and shift are fitted by least squares per view: of disparities to 1/z as for MiDaS (Ranftl et al. 2020,
section 5), of affine-invariant depths to z as for Marigold (Ke et al. 2024, section 4). Metric depths are scaled by the
ratio of medians (Zhou et al. 2017), since the unit of a COLMAP model is arbitrary.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.stats import spearmanr

from tdgbench.priors.prior import Kind

DELTA = 1.25


class Accuracy(NamedTuple):
    """Error of one map, or means over maps."""

    abs_rel: float  # mean of |z − z_true| / z_true
    delta: float  # share of pixels with max(z / z_true, z_true / z) < 1.25
    rank: float  # Spearman's rank correlation with depth, in [−1, 1]; needs no alignment


def accuracy(values: np.ndarray, kind: Kind, truth: np.ndarray) -> Accuracy:
    """Accuracy of prior values (N,) against true z (N,), both finite, z > 0.

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
    """Depths z (N,) that fit the truth (N,) best, within the truth's range (MiDaS clips to the data set's).

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

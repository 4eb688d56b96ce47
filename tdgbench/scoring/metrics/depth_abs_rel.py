"""Relative depth error."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ViewMetric


def depth_abs_rel(depth: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean of |z − z_true| / z_true over equally shaped depths.

    >>> round(depth_abs_rel(np.array([[1.1, 2.0]]), np.array([[1.0, 2.0]])), 6)
    0.05
    """
    return float((np.abs(depth.astype(np.float64) - truth) / truth).mean())


METRIC = ViewMetric(
    name="depth_abs_rel",
    label="depth error",
    meaning="mean of |z − true z| / true z",
    order=90,
    needs="true depth",
    of_view=lambda shown: depth_abs_rel(*shown.depths()),
)

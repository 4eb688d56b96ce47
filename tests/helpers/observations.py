"""Values of points in views, as a known thermal camera shows them."""

from __future__ import annotations

import numpy as np

from tdgbench.thermal.expected_errors import ExpectedErrors
from tdgbench.thermal.maps import TERMS, legendre_basis
from tdgbench.thermal.observations import PointSamples
from tdgbench.thermal.select_terms import prior_precision

SIZE = (64, 48)
DEGC = ExpectedErrors.in_unit("°C", 5.0)
NOWHERE = np.full(12, np.nan)  # positions of views that have no sequence
CLUSTERS = 10


def loose(data: PointSamples) -> np.ndarray:
    """Precision of a prior in which each view's offset is by itself."""
    return prior_precision(data, DEGC, None, np.full(data.views, np.nan))


def observations(
    offsets: np.ndarray, gains: np.ndarray, *, coefficients: np.ndarray | None = None,
    points: int = 400, noise: float = 0.05, outliers: float = 0.0, seed: int = 0,
) -> tuple[PointSamples, np.ndarray]:  # fmt: skip
    """Each point is seen by half of the views. offsets, gains: (V,), gains about 20 °C. Returns data, temperatures."""
    rng, views = np.random.default_rng(seed), len(offsets)
    degC = rng.normal(20, 5, points)
    point, view = np.nonzero(rng.random((points, views)) < 0.5)
    x, y = rng.random((2, len(point)))
    value = degC[point] + (gains[view] - 1) * (degC[point] - 20) + offsets[view]
    value += legendre_basis(x, y) @ (np.zeros(len(TERMS)) if coefficients is None else coefficients)
    value += rng.normal(0, noise, len(value)) + 10 * (rng.random(len(value)) < outliers)
    return _data(value, point, view, (x, y), point % CLUSTERS, (views, points)), degC


def along_a_line(
    travel: float, error: float, *, coefficients: np.ndarray | None = None, views: int = 12, points: int = 600,
    noise: float = 0.02, seed: int = 0,
) -> PointSamples:  # fmt: skip
    """An ideal camera, but for its vignette, that moves along a surface: x in the image is point − camera.

    travel: in widths of the image. error: °C, standard deviation over the clusters of what the values of a cluster
    change by on the way, as those of a reflection do.
    """
    rng = np.random.default_rng(seed)
    place, camera, height = rng.uniform(0, 1 + travel, points), np.linspace(0, travel, views), rng.random(points)
    is_seen = (place[:, None] > camera) & (place[:, None] < camera + 1) & (rng.random((points, views)) < 0.7)
    point, view = np.nonzero(is_seen)
    x, y = place[point] - camera[view], height[point]
    cluster = 2 * (place / (1 + travel) * CLUSTERS / 2).astype(int) + (height > 0.5)
    degC = 20 + 5 * np.sin(5 * place) + rng.normal(0, 2, points)
    change = rng.normal(0, error, CLUSTERS)[cluster[point]] * (2 * camera[view] / travel - 1)
    value = degC[point] + change + rng.normal(0, noise, len(point))
    value += legendre_basis(x, y) @ (np.zeros(len(TERMS)) if coefficients is None else coefficients)
    return _data(value, point, view, (x, y), cluster[point], (views, points))


def _data(
    value: np.ndarray, point: np.ndarray, view: np.ndarray, place: tuple[np.ndarray, np.ndarray], cluster: np.ndarray,
    counts: tuple[int, int],
) -> PointSamples:  # fmt: skip
    """place: x and y as shares of the image. counts: of views and points."""
    (x, y), (views, points), flat = place, counts, np.zeros(len(value))
    terms, sizes = legendre_basis(x, y), np.tile(SIZE, (views, 1))
    return PointSamples(point, view, value, flat, x * SIZE[0], y * SIZE[1], terms, cluster, sizes, points)

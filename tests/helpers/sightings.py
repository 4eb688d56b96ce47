"""Values of points in views, as a known thermal camera shows them."""

from __future__ import annotations

import numpy as np

from tdgbench.thermal.fit import PATCHES, Data
from tdgbench.thermal.polynomials import TERMS, basis

SIZE = (64, 48)


def sightings(
    offsets: np.ndarray, gains: np.ndarray, *, coefficients: np.ndarray | None = None,
    columns: np.ndarray | None = None, points: int = 400, noise: float = 0.05, outliers: float = 0.0, seed: int = 0,
) -> tuple[Data, np.ndarray]:  # fmt: skip
    """Each point is seen by half of the views. offsets, gains: (V,), gains about 20 °C. Returns data, temperatures."""
    rng, views = np.random.default_rng(seed), len(offsets)
    degC = rng.normal(20, 5, points)
    point, view = np.nonzero(rng.random((points, views)) < 0.5)
    x, y = rng.random((2, len(point)))
    terms, column = basis(x, y), (x * SIZE[0]).astype(int)
    value = degC[point] + (gains[view] - 1) * (degC[point] - 20) + offsets[view]
    value += terms @ (np.zeros(len(TERMS)) if coefficients is None else coefficients)
    value += 0 if columns is None else columns[column]
    value += rng.normal(0, noise, len(value)) + 10 * (rng.random(len(value)) < outliers)
    row = (y * SIZE[1]).astype(int)
    patch = (view * PATCHES + (y * PATCHES).astype(int)) * PATCHES + (x * PATCHES).astype(int)
    flat = np.zeros(len(value))
    return Data(value, flat, point, view, flat, terms, patch, column, row, views, points, SIZE), degC

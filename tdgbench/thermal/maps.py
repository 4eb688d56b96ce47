"""Vignette of a thermal camera: a smooth map.

It is a sum of products of Legendre polynomials in x and y, orthonormal over the image, without a constant. Degree 4
holds the radial polynomials r² and r⁴ about any centre near the image, and a tilt.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import legvander

DEGREE = 4
TERMS = [(i, total - i) for total in range(1, DEGREE + 1) for i in range(total + 1)]  # degrees in x and y


def legendre_basis(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return values (N, K) of the polynomials at positions (N,) as shares of the image's width and height, in [0, 1].

    >>> legendre_basis(np.array([0.5]), np.array([0.5])).round(2)[0, :5].tolist()
    [0.0, 0.0, -1.12, 0.0, -1.12]
    """
    along_x, along_y = along(x), along(y)
    return np.stack([along_x[:, i] * along_y[:, j] for i, j in TERMS], axis=1)


def evaluate(coefficients: np.ndarray, width: int, height: int) -> np.ndarray:
    """Map (height, width) with coefficients (K,); its mean is 0."""
    weights = np.zeros((DEGREE + 1, DEGREE + 1))
    for (i, j), coefficient in zip(TERMS, coefficients, strict=True):
        weights[j, i] = coefficient
    across, down = (along((np.arange(size) + 0.5) / size) for size in (width, height))
    values = down @ weights @ across.T
    return np.asarray(values - values.mean())


def along(share: np.ndarray) -> np.ndarray:
    """Return the polynomials (N, DEGREE + 1) in one direction, at shares (N,) of the image's side."""
    return np.asarray(legvander(2 * share - 1, DEGREE) * np.sqrt(2 * np.arange(DEGREE + 1) + 1))

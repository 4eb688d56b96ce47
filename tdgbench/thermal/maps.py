"""Vignette and fixed pattern of a thermal camera: a smooth map, and one value for each column and row.

Smooth maps are products of Legendre polynomials in x and y, orthonormal over the image, without a constant. Degree 4
holds the radial polynomials r² and r⁴ about any centre near the image, and a tilt.

The fixed pattern is estimated from the residuals of the smooth response. The mean of each column or row is shrunk
towards 0 by its uncertainty (empirical Bayes), so that noise does not become a pattern. A pattern of single pixels
cannot be estimated: sparse points observe each pixel about once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.polynomial.legendre import legvander

DEGREE = 4
TERMS = [(i, total - i) for total in range(1, DEGREE + 1) for i in range(total + 1)]  # degrees in x and y
SIGNIFICANT = 4.0  # standard errors by which the variance of lines must exceed what noise gives them
FEWEST_LINES = 16  # with values


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


def line_map(
    columns: Sequence[float] | np.ndarray | None, rows: Sequence[float] | np.ndarray | None, width: int, height: int
) -> np.ndarray:
    """Return fixed pattern (height, width) of columns and rows; 0 where there are none.

    Raises ValueError for an image of another size than those that it was estimated from.
    """
    pattern = np.zeros((height, width))
    for lines, size, axis in ((columns, width, 0), (rows, height, 1)):
        if lines is not None and len(lines):
            if len(lines) != size:
                raise ValueError(f"the fixed pattern has {len(lines)} lines, an image of {width}×{height} px has not")
            pattern += np.expand_dims(np.asarray(lines), axis)
    return pattern


def line_pattern(residuals: np.ndarray, weights: np.ndarray, line: np.ndarray, lines: int) -> np.ndarray | None:
    """Return pattern (lines,) of mean 0, or None if it cannot be told from noise.

    residuals, weights: (S,), weights being inverse variances, 0 of outliers. line: (S,) column or row of each.
    """
    total = np.bincount(line, weights, lines)
    known = total > 0
    if np.count_nonzero(known) < FEWEST_LINES:
        return None
    mean = np.zeros(lines)
    mean[known] = np.bincount(line, weights * residuals, lines)[known] / total[known]
    spread = np.sum(weights * residuals**2) / np.sum(weights)
    scale = spread * np.sum(weights) / np.count_nonzero(weights)  # of variances: 1 if the weights are right
    noise = np.zeros(lines)
    noise[known] = scale / total[known]
    excess = mean[known] ** 2 - noise[known]
    variance = float(np.mean(excess))
    if variance <= SIGNIFICANT * np.sqrt(2 * np.mean(noise[known] ** 2) / np.count_nonzero(known)):
        return None
    pattern = np.zeros(lines)
    pattern[known] = mean[known] * variance / (variance + noise[known])
    return pattern - pattern.mean()

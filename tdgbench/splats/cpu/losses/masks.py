"""Masks of image losses: which pixels count.

A masked pixel is outside the image, as far as a loss is concerned: it is 0 in both images, where SSIM's windows reach
it, has no loss and no gradient, and makes no pair with its neighbours.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)


def pixel_weights(valid: np.ndarray, channels: int) -> np.ndarray:
    """Return weights float32 (H, W · channels), 1 where the mask (H, W) is true and 0 elsewhere.

    Raises ValueError if it is true nowhere.

    >>> pixel_weights(np.array([[True, False]]), 2).tolist()
    [[1.0, 1.0, 0.0, 0.0]]
    """
    if not valid.any():
        raise ValueError("no pixel of the image is valid, so that it has no loss")
    return np.repeat(valid, channels, axis=1).astype(F)


def without_masked(image: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the image (rows, columns · channels) with 0 where the weights, shaped as it, are 0.

    >>> without_masked(np.array([[np.nan, 2.0]], F), np.array([[0.0, 1.0]], F)).tolist()
    [[0.0, 2.0]]
    """
    out = np.empty_like(image)
    pool.run_bands(keep_rows, len(image), image, weights, out)
    return out


@kernel()
def keep_rows(start, stop, image, weights, out):
    """Rows [start, stop) of `without_masked`; arrays (rows, columns · channels)."""
    for y in range(start, stop):
        row, kept, target = image[y], weights[y], out[y]
        for x in range(U(row.shape[0])):  # no arithmetic with the value, which may be NaN
            target[x] = row[x] if kept[x] > ZERO else ZERO


@kernel(inline=True)
def weight_of_pair(weights, y, x, other_y, other_x):
    """1 if both pixels count, else 0; 1 without a mask. weights: (rows, columns), or None."""
    if weights is None:
        return ONE
    return weights[y, x] * weights[other_y, other_x]


@kernel(inline=True)
def apply_mask(values, weights, y):
    """values (columns,) *= row y of the weights (rows, columns); nothing without a mask."""
    if weights is not None:
        for x in range(U(values.shape[0])):
            values[x] *= weights[y, x]

"""Masks of image losses: which pixels count.

A masked pixel is outside the image, as far as a loss is concerned: it is 0 in both images, where SSIM's windows reach
it, has no loss and no gradient, and makes no pair with its neighbours.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64
ONE = F(1)


def pixel_weights(valid: np.ndarray, channels: int) -> np.ndarray:
    """Weights float32 (H, W · channels), 1 where the mask (H, W) is true and 0 elsewhere.

    Raises ValueError if it is true nowhere.

    >>> pixel_weights(np.array([[True, False]]), 2).tolist()
    [[1.0, 1.0, 0.0, 0.0]]
    """
    if not valid.any():
        raise ValueError("no pixel of the image is valid, so that it has no loss")
    return np.repeat(valid.astype(F), channels, axis=1)


def without_masked(image: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """The image (H, W, C), or map (H, W), with 0 where the mask (H, W) is false, whatever it holds there.

    >>> without_masked(np.array([[np.nan, 1.0]], F), np.array([[False, True]])).tolist()
    [[0.0, 1.0]]
    """
    return np.where(valid.reshape(valid.shape + (1,) * (image.ndim - 2)), image, F(0))


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

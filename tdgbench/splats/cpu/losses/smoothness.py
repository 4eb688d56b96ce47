"""Differences of neighbouring pixels and their gradient, row by row.

Each pair of neighbours (i, j) adds |T_i − T_j| to the sum and ± sign(T_i − T_j) to the gradient of both.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses.row_sums import difference_sum

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)


@kernel(inline=True)
def sign(x):
    """−1, 0 or 1."""
    return ONE if x > ZERO else (-ONE if x < ZERO else ZERO)


@kernel(inline=True)
def row_below(y, rows, wrap):
    """Number of the row below row y; y itself at the bottom without `wrap`."""
    return y + 1 if y < rows - 1 else (0 if wrap else y)


@kernel(inline=True)
def neighbour_differences(y, image, channels, wrap):
    """Σ |right − here| + Σ |below − here| of row y of an image (rows, columns · channels); `wrap`: on a torus."""
    here = image[y]
    count = here.shape[0]
    total = difference_sum(image[row_below(y, image.shape[0], wrap)], here)
    total += difference_sum(here[channels:], here[: count - channels])
    if wrap:
        total += difference_sum(here[:channels], here[count - channels :])
    return total


@kernel()
def add_difference_gradient(y, image, channels, wrap, scale, out):
    """out (columns · channels,) += scale · Σ over the 4 neighbours of sign(here − neighbour), in row y.

    image: (rows, columns · channels). With `wrap` the image is a torus; without it, there are no pairs across the
    border.
    """
    rows, columns = image.shape
    c = U(channels)
    here, below = image[y], image[row_below(y, rows, wrap)]
    above = image[y - 1] if y > 0 else (image[rows - 1] if wrap else here)
    for x in range(U(columns)):
        out[x] += scale * (sign(here[x] - above[x]) + sign(here[x] - below[x]))
    for x in range(U(columns - channels)):
        out[x] += scale * sign(here[x] - here[x + c])
    for x in range(c, U(columns)):
        out[x] += scale * sign(here[x] - here[x - c])
    if wrap:
        for x in range(c):
            last = U(columns - channels) + x
            out[last] += scale * sign(here[last] - here[x])
            out[x] += scale * sign(here[x] - here[last])


@kernel()
def difference_rows(start, stop, image, channels, wrap, sums, gradient):
    """Rows [start, stop): sums (rows,) of `neighbour_differences`, and gradient (rows, columns · channels)."""
    for y in range(start, stop):
        add_difference_gradient(y, image, channels, wrap, ONE, gradient[y])
        sums[y] = neighbour_differences(y, image, channels, wrap)


def differences_and_gradient(image: np.ndarray, wrap: bool) -> tuple[float, np.ndarray]:
    """Σ |differences| over the pairs of neighbours in a float32 image (H, W, C), and its gradient (H, W, C).

    >>> image = np.array([[[1.0], [3.0]]], np.float32)
    >>> total, gradient = differences_and_gradient(image, wrap=False)
    >>> total, gradient[..., 0].tolist()
    (2.0, [[-1.0, 1.0]])
    """
    height, width, channels = image.shape
    flat = image.reshape(height, width * channels)
    sums, gradient = np.empty(height, np.float64), np.zeros_like(flat)
    bands = pool.chunks(height, min(height, pool.get_threads()))
    pool.run(difference_rows, [(*band, flat, channels, wrap, sums, gradient) for band in bands])
    return float(sums.sum()), gradient.reshape(image.shape)

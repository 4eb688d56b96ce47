"""Differences of neighbouring pixels and their gradient, row by row.

Every pair of neighbours (i, j) adds |T_i − T_j| to the sum and ± sign(T_i − T_j) to the gradient of both.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)


@kernel(inline=True)
def sign(x):
    return ONE if x > ZERO else (-ONE if x < ZERO else ZERO)


@kernel(free_sums=True)
def difference_row(y, image, channels, wrap, scale, out):
    """Σ |right − own| + Σ |below − own| of row y; out += scale · Σ over the 4 neighbours of sign(own − other).

    Without `wrap` pairs across the border do not exist; with it the image is a torus.
    """
    rows, columns = image.shape
    c = U(channels)
    own = image[y]
    above = image[y - 1] if y > 0 else (image[rows - 1] if wrap else own)
    below = image[y + 1] if y < rows - 1 else (image[0] if wrap else own)
    total = ZERO
    for x in range(U(columns)):
        total += abs(below[x] - own[x])
        out[x] += scale * (sign(own[x] - above[x]) + sign(own[x] - below[x]))
    for x in range(U(columns - channels)):
        total += abs(own[x + c] - own[x])
        out[x] += scale * sign(own[x] - own[x + c])
    for x in range(c, U(columns)):
        out[x] += scale * sign(own[x] - own[x - c])
    if wrap:
        for x in range(c):
            last = U(columns - channels) + x
            total += abs(own[x] - own[last])
            out[last] += scale * sign(own[last] - own[x])
            out[x] += scale * sign(own[x] - own[last])
    return total


@kernel()
def difference_rows(start, stop, image, channels, wrap, sums, gradient):
    """`difference_row` for rows [start, stop)."""
    for y in range(start, stop):
        sums[y] = difference_row(y, image, channels, wrap, ONE, gradient[y])


def differences_and_gradient(image: np.ndarray, wrap: bool) -> tuple[float, np.ndarray]:
    """Σ over neighbouring pairs of |difference| of a float32 image (H, W, C), and its gradient."""
    height, width, channels = image.shape
    flat = image.reshape(height, width * channels)
    sums, gradient = np.empty(height, np.float64), np.zeros_like(flat)
    bands = pool.chunks(height, min(height, pool.get_threads()))
    pool.run(difference_rows, [(*band, flat, channels, wrap, sums, gradient) for band in bands])
    return float(sums.sum()), gradient.reshape(image.shape)

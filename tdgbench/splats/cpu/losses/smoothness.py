"""Differences of neighbouring pixels and their gradient, row by row.

Each pair of neighbours (i, j) adds |T_i − T_j| to the sum and ± sign(T_i − T_j) to the gradient of both. A pair with a
masked pixel (`masks`) adds nothing.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses.masks import weight_of_pair
from tdgbench.splats.cpu.simd.reductions import difference_sum

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
def row_above(y, rows, wrap):
    """Number of the row above row y; y itself at the top without `wrap`."""
    return y - 1 if y > 0 else (rows - 1 if wrap else y)


@kernel(inline=True)
def neighbour_differences(y, image, weights, channels, wrap):
    """Σ |right − here| + Σ |below − here| of row y of an image (rows, columns · channels); `wrap`: on a torus.

    weights: of the pixels, shaped as the image, or None.
    """
    here, under = image[y], row_below(y, image.shape[0], wrap)
    count = here.shape[0]
    if weights is None:
        total = difference_sum(image[under], here, None, None)
        total += difference_sum(here[channels:], here[: count - channels], None, None)
        if wrap:
            total += difference_sum(here[:channels], here[count - channels :], None, None)
        return total
    w = weights[y]
    total = difference_sum(image[under], here, weights[under], w)
    total += difference_sum(here[channels:], here[: count - channels], w[channels:], w[: count - channels])
    if wrap:
        total += difference_sum(here[:channels], here[count - channels :], w[:channels], w[count - channels :])
    return total


@kernel()
def add_difference_gradient(y, image, weights, channels, wrap, scale, out):
    """out (columns · channels,) += scale · Σ over the 4 neighbours of sign(here − neighbour), in row y.

    image: (rows, columns · channels). With `wrap` the image is a torus; without it, there are no pairs across the
    border. weights: of the pixels, shaped as the image, or None.
    """
    rows, columns = image.shape
    c = U(channels)
    over, under = row_above(y, rows, wrap), row_below(y, rows, wrap)
    here, above, below = image[y], image[over], image[under]
    for x in range(U(columns)):
        to_above = sign(here[x] - above[x]) * weight_of_pair(weights, y, x, over, x)
        to_below = sign(here[x] - below[x]) * weight_of_pair(weights, y, x, under, x)
        out[x] += scale * (to_above + to_below)
    for x in range(U(columns - channels)):
        out[x] += scale * sign(here[x] - here[x + c]) * weight_of_pair(weights, y, x, y, x + c)
    for x in range(c, U(columns)):
        out[x] += scale * sign(here[x] - here[x - c]) * weight_of_pair(weights, y, x, y, x - c)
    if wrap:
        for x in range(c):
            last = U(columns - channels) + x
            weight = weight_of_pair(weights, y, last, y, x)
            out[last] += scale * sign(here[last] - here[x]) * weight
            out[x] += scale * sign(here[x] - here[last]) * weight

"""Rows of images with a mask: sums, and differences of neighbouring pixels with their gradient.

A masked pixel is outside the image, as far as a loss is concerned: it is 0 in both images, where SSIM's windows reach
it, has no loss and no gradient, and makes no pair with its neighbours.
Each pair of neighbours (i, j) adds |T_i − T_j| to the sum and ± sign(T_i − T_j) to the gradient of both.
Sums have a fixed order. One that the compiler may reorder comes out differently, in its last bits, where it is compiled
in another context: in the process that compiles a kernel, and in one that loads it from the machine-code cache.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd.memory import load_anywhere
from tdgbench.splats.cpu.simd.registers import LANES, absolute, broadcast, lane_sum

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)


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


@kernel(inline=True)
def row_sum(values):
    """Σ values (columns,)."""
    count = U(values.shape[0])
    whole = count - count % U(LANES)
    partial = broadcast(ZERO)
    for x in range(U(0), whole, U(LANES)):
        partial = partial + load_anywhere(values, x)
    total = lane_sum(partial)
    for x in range(whole, count):
        total += values[x]
    return total


@kernel(inline=True)
def difference_sum(a, b, v, w):
    """Σ v w |a − b| of rows a and b (columns,), with the weights v and w of their values (columns,), or None."""
    count = U(a.shape[0])
    whole = count - count % U(LANES)
    partial = broadcast(ZERO)
    for x in range(U(0), whole, U(LANES)):
        difference = absolute(load_anywhere(a, x) - load_anywhere(b, x))
        if v is None:
            partial = partial + difference
        else:
            partial = partial + load_anywhere(v, x) * load_anywhere(w, x) * difference
    total = lane_sum(partial)
    for x in range(whole, count):
        if v is None:
            total += abs(a[x] - b[x])
        else:
            total += v[x] * w[x] * abs(a[x] - b[x])
    return total


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

"""Statistics of a view for density control: visible Gaussians, their radii, their image-plane gradients."""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu.jit import kernel

U = np.uint64


@kernel()
def observe_visible(first, count, index, radii, view_counts, max_radii):
    """Count the view for the visible Gaussians (radius above zero) and update their largest radius.

    index, radii: int32 (capacity,), of which [first, first + count) is read; view_counts, max_radii (px): float32 (N,).
    """
    for r in range(U(first), U(first + count)):
        if radii[r] > 0:
            i = U(index[r])
            view_counts[i] += np.float32(1)
            max_radii[i] = max(max_radii[i], np.float32(radii[r]))


@kernel()
def observe_gradients(first, count, index, image, half_width, half_height, grad_sum):
    """Add the length of the image-plane gradient of the visible Gaussians, in units of half the image.

    index: int32 (capacity,); image: float32 (capacity, 3), see `Gradients.image`; of both [first, first + count)
    is read. grad_sum: float32 (N,).
    """
    for r in range(U(first), U(first + count)):
        if image[r, U(2)] > np.float32(0):
            gu, gv = image[r, U(0)] * half_width, image[r, U(1)] * half_height
            grad_sum[U(index[r])] += math.sqrt(gu * gu + gv * gv)

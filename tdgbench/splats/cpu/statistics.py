"""What density control gathers from a view: how often each Gaussian was seen, how large, and how hard it was pulled."""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats.cpu.jit import kernel

U = np.uint64


@kernel()
def observe_seen(first, count, index, radii, times_seen, max_radii):
    """Count the Gaussians in sight (radius above zero) and keep their largest radius."""
    for r in range(U(first), U(first + count)):
        if radii[r] > 0:
            i = U(index[r])
            times_seen[i] += np.float32(1)
            max_radii[i] = max(max_radii[i], np.float32(radii[r]))


@kernel()
def observe_gradients(first, count, index, image, half_width, half_height, grad_sum):
    """Add the length of the image gradient, in units of half the image, of Gaussians in sight."""
    for r in range(U(first), U(first + count)):
        if image[r, U(2)] > np.float32(0):
            gu, gv = image[r, U(0)] * half_width, image[r, U(1)] * half_height
            grad_sum[U(index[r])] += math.sqrt(gu * gu + gv * gv)

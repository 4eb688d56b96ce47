"""Which Gaussians a camera may see: a test that is never wrong about the others, on four numbers a Gaussian.

A Gaussian lies within `slack` of where it is thought to be, and no axis is longer than thought by more than a factor:
the optimiser moves what it has not seen for a while only when it is looked at again (`tdgbench.splats.optimizer`).
The image covariance's largest eigenvalue is at most |J|² σ² + eps2d, alpha ≥ min_alpha ends at `reach` of its roots.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.projection import camera_point, exponential, ray_limits
from tdgbench.splats.cpu.simd.memory import aligned_floats, gather, gather_3, store
from tdgbench.splats.cpu.simd.reductions import any_positive
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    divide,
    greater,
    less_equal,
    maximum,
    select,
    splat,
    square_root,
)

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)
MARGIN = F(1.02)  # of the reach, against rounding
GRID = F(18)  # px: the last tile may stick out of the image by 15


@kernel()
def find_candidates(start, stop, means, mean_stride, mean_column, sizes, size_stride, size_column, size_count, raw,
                    slack, growth, camera, reach_limit, candidates):  # fmt: skip
    """candidates[start : start + n] = those of Gaussians [start, stop) that may be seen, ascending; returns n.

    Behind them the last one is repeated to fill a register. sizes: 1 or 3 deviations each (`raw`: their logarithms,
    to which `growth` is added). start is a multiple of LANES.
    """
    rows = np.empty(LANES, np.int32)
    flags = aligned_floats(LANES)
    left, right, top, bottom = ray_limits(camera)
    steepest = max(abs(left), abs(right)) ** 2, max(abs(top), abs(bottom)) ** 2
    jacobian = camera[12] * camera[12] * (ONE + steepest[0]) + camera[13] * camera[13] * (ONE + steepest[1])
    blur = camera[21] + camera[21] + F(0.4)
    near, far = camera[19], camera[20]
    one, zero = splat(ONE), splat(ZERO)
    found = start
    for base in range(start, stop, LANES):
        for lane in range(LANES):
            rows[lane] = min(base + lane, stop - 1)
        x, y, z = camera_point(gather_3(means, rows, 0, mean_stride, mean_column), camera)
        size = gather(sizes, rows, 0, size_stride, size_column)
        if size_count == 3:
            size = maximum(size, gather(sizes, rows, 0, size_stride, size_column + 1))
            size = maximum(size, gather(sizes, rows, 0, size_stride, size_column + 2))
        if raw:
            size = exponential(size + growth)
        nearest, farthest = maximum(z - slack, splat(near)), z + slack
        per_near, per_far = divide(ONE, nearest), divide(ONE, maximum(farthest, splat(near)))
        stretch = size * per_near
        reach = MARGIN * reach_limit * square_root(stretch * stretch * jacobian + blur) + GRID
        right_most, left_most = x + slack, x - slack
        bottom_most, top_most = y + slack, y - slack
        u_right = right_most * select(greater(right_most, zero), per_near, per_far) * camera[12] + camera[14] + reach
        u_left = left_most * select(greater(left_most, zero), per_far, per_near) * camera[12] + camera[14] - reach
        v_bottom = bottom_most * select(greater(bottom_most, zero), per_near, per_far) * camera[13] + camera[15] + reach
        v_top = top_most * select(greater(top_most, zero), per_far, per_near) * camera[13] + camera[15] - reach
        hidden = select(less_equal(farthest, splat(near)), one, zero)
        hidden = select(greater(z - slack, splat(far)), one, hidden)
        hidden = select(less_equal(u_right, zero), one, hidden)
        hidden = select(greater(u_left, splat(camera[22])), one, hidden)
        hidden = select(less_equal(v_bottom, zero), one, hidden)
        hidden = select(greater(v_top, splat(camera[23])), one, hidden)
        visible = ONE - hidden
        if any_positive(visible):
            store(flags, 0, visible)
            for lane in range(min(LANES, stop - base)):
                if flags[U(lane)] > ZERO:
                    candidates[U(found)] = base + lane
                    found += 1
    count = found - start
    if count > 0:
        for k in range(found, start + (count + LANES - 1) // LANES * LANES):
            candidates[U(k)] = candidates[U(found - 1)]
    return count

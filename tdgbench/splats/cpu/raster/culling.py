"""Culling: a test on four numbers a Gaussian that never rules out one that a camera sees.

The optimiser defers steps of Gaussians without gradient, so a Gaussian lies within `tolerance` of its bounds' mean, and
its axes are longer than the bounds' by no more than a factor. The image covariance's largest eigenvalue is at most
|J|² σ² + eps2d, and alpha falls below min_alpha at `cutoff` of its roots.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blocks import NONE
from tdgbench.splats.cpu.raster.projection import camera_point, exponential, ray_limits
from tdgbench.splats.cpu.raster.types import BOUNDS, GaussianSource, Settings, Span
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.memory import gather, load_fours
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    broadcast,
    divide,
    greater,
    is_nan,
    lane_bits,
    less_equal,
    lowest,
    maximum,
    select,
    square_root,
)

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)
MARGIN = F(1.02)  # × the cutoff, against rounding
GAUSSIANS_EACH, CANDIDATES_EACH = 65_536, 4096  # that are worth a thread: to test one takes 2 ns, to project one 40
GRID = F(18)  # px: the last tile may stick out of the image by 15


def find_candidates(source: GaussianSource, settings: Settings, workspace: Workspace) -> tuple[np.ndarray, list[Span]]:
    """Ascending candidates, int32, and spans of them for the threads, of equal length, on register bounds."""
    threads = pool.threads_for(source.count, GAUSSIANS_EACH)
    groups = -(-source.count // LANES)
    pieces = [(a * LANES, min(b * LANES, source.count)) for a, b in pool.chunks(groups, min(threads, max(groups, 1)))]
    candidates = workspace.take("candidates", max(groups, 1) * LANES, np.int32)
    shared = (source.bounds, settings.camera, settings.limits.cutoff, candidates)
    found = pool.run(cull, [(*piece, *shared) for piece in pieces])
    return candidates, _pack(candidates, [(a, n) for (a, _), n in zip(pieces, found)])


def _pack(candidates: np.ndarray, found: list[Span]) -> list[Span]:
    """Close the gaps between the spans found, in place; cut the whole into equal spans on register bounds."""
    total = 0
    for first, count in found:
        if first != total:
            candidates[total : total + count] = candidates[first : first + count]
        total += count
    groups = -(-total // LANES)
    candidates[total : groups * LANES] = candidates[total - 1] if total else 0
    cuts = pool.chunks(groups, min(pool.threads_for(total, CANDIDATES_EACH), max(groups, 1)))
    return [(a * LANES, min(b * LANES, total) - a * LANES) for a, b in cuts]


@kernel()
def cull(start, stop, bounds, camera, cutoff, candidates):
    """candidates[start : start + n] = Gaussians of [start, stop) that may be visible, ascending; returns n.

    Behind them the last one is repeated to fill a register. start is a multiple of LANES. bounds: Bounds;
    camera: Camera; cutoff in σ; candidates (capacity,) int32.
    """
    rows = np.empty(LANES, np.int32)
    left, right, top, bottom = ray_limits(camera)
    steepest = max(abs(left), abs(right)) ** 2, max(abs(top), abs(bottom)) ** 2
    jacobian = camera.fx * camera.fx * (ONE + steepest[0]) + camera.fy * camera.fy * (ONE + steepest[1])
    blur = camera.eps2d + camera.eps2d + F(0.4)
    found = start
    for base in range(start, stop, LANES):
        mean, size = culling_bounds(bounds, base, stop, rows)
        x, y, z = camera_point(mean, camera)
        near = maximum(z - bounds.tolerance, broadcast(camera.near))
        stretch = size * divide(ONE, near)
        radius = MARGIN * cutoff * square_root(stretch * stretch * jacobian + blur) + GRID
        visible = lane_bits(less_equal(hidden(x, y, z, radius, bounds.tolerance, camera), broadcast(ZERO)))
        visible |= lane_bits(is_nan(mean[0] + mean[1] + mean[2] + size))  # it could be anywhere
        visible &= (U(1) << U(min(LANES, stop - base))) - U(1)
        while visible != NONE:
            candidates[U(found)] = base + np.int64(lowest(visible))
            visible &= visible - U(1)
            found += 1
    count = found - start
    if count > 0:
        for k in range(found, start + (count + LANES - 1) // LANES * LANES):
            candidates[U(k)] = candidates[U(found - 1)]
    return count


@kernel(inline=True)
def culling_bounds(bounds, base, stop, rows):
    """Means of the Gaussians [base, base + LANES), and bounds of their standard deviations, world units.

    Lanes from `stop` on hold Gaussian stop − 1. rows (LANES,) int32 is scratch.
    """
    values = bounds.values
    if base + LANES <= stop:
        x, y, z, size = load_fours(values, base * BOUNDS)
    else:
        for lane in range(LANES):
            rows[lane] = min(base + lane, stop - 1)
        x, y = gather(values, rows, 0, BOUNDS, 0), gather(values, rows, 0, BOUNDS, 1)
        z, size = gather(values, rows, 0, BOUNDS, 2), gather(values, rows, 0, BOUNDS, 3)
    if bounds.raw:
        size = exponential(size + bounds.growth)
    return (x, y, z), size


@kernel(inline=True)
def hidden(x, y, z, radius, tolerance, camera):
    """1 in lanes whose Gaussian cannot be visible, else 0; x, y, z in camera coordinates, radius in px."""
    one, zero = broadcast(ONE), broadcast(ZERO)
    farthest = z + tolerance
    per_near = divide(ONE, maximum(z - tolerance, broadcast(camera.near)))
    per_far = divide(ONE, maximum(farthest, broadcast(camera.near)))
    right_most, left_most = x + tolerance, x - tolerance
    bottom_most, top_most = y + tolerance, y - tolerance
    u_right = right_most * select(greater(right_most, zero), per_near, per_far) * camera.fx + camera.cx + radius
    u_left = left_most * select(greater(left_most, zero), per_far, per_near) * camera.fx + camera.cx - radius
    v_bottom = bottom_most * select(greater(bottom_most, zero), per_near, per_far) * camera.fy + camera.cy + radius
    v_top = top_most * select(greater(top_most, zero), per_far, per_near) * camera.fy + camera.cy - radius
    out = select(less_equal(farthest, broadcast(camera.near)), one, zero)
    out = select(greater(z - tolerance, broadcast(camera.far)), one, out)
    out = select(less_equal(u_right, zero), one, out)
    out = select(greater(u_left, broadcast(camera.width)), one, out)
    out = select(less_equal(v_bottom, zero), one, out)
    return select(greater(v_top, broadcast(camera.height)), one, out)

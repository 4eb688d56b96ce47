"""From Gaussians to splats, LANES at a time: project, colour, and list the tiles of each that can be visible.

They are projected as registers, then read lane by lane. `group` (GROUP · LANES,) float32 holds the registers; `i` is an
unsigned lane.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import apply_deferred, prefetch_gaussian
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster import types as splat
from tdgbench.splats.cpu.raster.blocks import NONE
from tdgbench.splats.cpu.raster.projection import (
    GATHERED,
    LOG2_E,
    collect,
    color_column,
    exact_image_point,
    footprint_of,
    opacity_and_log2,
    screen_radius,
)
from tdgbench.splats.cpu.raster.sh_registers import view_direction, write_basis
from tdgbench.splats.cpu.raster.tiles import SLACK, TILE, Ellipse, PixelBox, list_box, list_tiles
from tdgbench.splats.cpu.raster.types import GaussianSource, Projected, Settings, Span, Splats
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    float_bits,
    load,
    prefetch_columns,
    store,
    store_whole,
    turn_block,
)
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    any_positive,
    broadcast,
    divide,
    greater,
    greater_equal,
    is_nan,
    lane_bits,
    lowest,
    maximum,
    minimum,
    narrow,
    round_down,
    round_up,
    select,
    square_root,
    widen,
)

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
# Registers of a group. 0 to 15 are the columns of a splat, of which the last two begin the box.
LAST_X, LAST_Y, VALID, KEEP, Z, WIDE, HIGH, SLOPE, CUT, DET, U_SINGLE, V_SINGLE, GROUP = range(
    splat.FLOATS, splat.FLOATS + 13
)
PAIRS_PER_CANDIDATE, MIN_PAIRS = 6, 4096  # first guess of the capacity for pairs
PREFETCH_DISTANCE = 2 * LANES  # candidates


class PairTiles(NamedTuple):
    """Tiles of one thread's pairs, which are numbered from `first`."""

    first: int
    tiles: np.ndarray  # (capacity,) int32
    counts: np.ndarray  # (tiles,) int64: pairs of each


class ProjectedView(NamedTuple):
    """Result of the projection by all threads."""

    projected: Projected
    projected_spans: list[Span]
    splats: Splats
    splat_spans: list[Span]
    pair_tiles: np.ndarray  # (pair capacity,) int32
    pair_spans: list[Span]
    tile_counts: np.ndarray  # (threads, tiles) int64: pairs
    has_nan: bool  # in any Gaussian


def project_candidates(
    source: GaussianSource,
    settings: Settings,
    candidates: np.ndarray,
    spans: list[Span],
    workspace: Workspace,
    scratch: Workspace,
) -> ProjectedView:
    """Project the spans of candidates (int32), a thread each. workspace: memory that the backward pass reads again."""
    capacity = -(-max(sum(n for _, n in spans), 1) // LANES) * LANES
    splats = Splats(
        workspace.take("splats", (capacity, splat.FLOATS), np.float32),
        workspace.take("gaussian ids", capacity, np.int32),
        workspace.take("pairs", (capacity, 2), np.int32),
        scratch.take("keys", capacity, np.uint32),
    )
    projected = Projected(
        workspace.take("projected", capacity, np.int32),
        workspace.take("radii", capacity, np.int32),
        workspace.take("means2d", (0 if source.parameters.raw else capacity, 2), np.float32),
    )
    shared = (source.parameters, source.stale, settings, splats, projected)
    n_tiles = -(-settings.width // TILE) * -(-settings.height // TILE)
    pairs = max(MIN_PAIRS, PAIRS_PER_CANDIDATE * capacity // len(spans))
    while True:
        tiles = scratch.take("tiles", (len(spans), pairs), np.int32)
        tile_counts = np.zeros((len(spans), n_tiles), np.int64)
        found = pool.run(
            project_and_list,
            [
                (*span, candidates, *shared, PairTiles(t * pairs, tiles[t], tile_counts[t]))
                for t, span in enumerate(spans)
            ],
        )  # fmt: skip
        n_splats, n_pairs, n_projected, has_nan = zip(*found)
        if max(n_pairs) <= pairs:
            break
        pairs = max(n_pairs)
    splat_spans, projected_spans = (
        [(first, n) for (first, _), n in zip(spans, counts)] for counts in (n_splats, n_projected)
    )
    pair_spans = [(t * pairs, n) for t, n in enumerate(n_pairs)]
    return ProjectedView(
        projected, projected_spans, splats, splat_spans, tiles.reshape(-1), pair_spans, tile_counts, any(has_nan)
    )


@kernel()
def project_and_list(first, count, candidates, parameters, stale, settings, splats, projected, pair_tiles):
    """Project candidates [first, first + count); rows of splats and projected are written from `first` on.

    candidates (n,) int32; the types of the others have their names; stale: of Gaussians with deferred steps, which are
    applied before they are read. Returns the numbers of splats, of pairs, which are written up to the capacity, and of
    projected Gaussians, and whether anything is NaN.
    """
    channels, camera, limits, raw = settings.channels, settings.camera, settings.limits, parameters.raw
    tiles_x = (int64(camera.width) + TILE - 1) // TILE
    # parameters, registers of the group, harmonics, splats one after the other, and boxes of LANES Gaussians
    gathered, group, basis = aligned_floats(GATHERED * LANES), aligned_floats(GROUP * LANES), aligned_floats(16 * LANES)
    rows, boxes = aligned_floats(splat.FLOATS * LANES), np.zeros(4 * LANES, np.int32)
    has_nan = broadcast(ZERO)
    n_splats, n_projected, n_pairs = first, first, int64(0)  # for a literal, helpers would be compiled once more
    # a reference in the loop costs an atomic operation
    tiles, tile_counts = pair_tiles.tiles, pair_tiles.counts
    flat_splats, pairs = splats.values.reshape(-1), splats.pairs
    gaussian_ids, keys = splats.gaussian_ids, splats.depth_keys
    end = first + count
    for k in range(first, min(first + LANES, end)):
        apply_steps(stale, candidates, k)
    for k in range(first, end, LANES):
        prefetch_group(parameters, stale, channels.columns, candidates, k + PREFETCH_DISTANCE, end)
        collect(parameters, candidates, k, channels.columns, gathered)
        mean, has_nan = project_group(group, gathered, channels.columns.opacity, raw, camera, limits, has_nan)
        write_channels(group, gathered, channels, mean, camera, basis)
        for c in range(0, splat.FLOATS, LANES):
            turn_block(group, c * LANES, LANES, rows, c, splat.FLOATS)
        for side in range(4):
            store_whole(boxes, side * LANES, load(group, (splat.FIRST_X + side) * LANES))
        in_use = (U(1) << U(min(LANES, end - k))) - U(1)
        valid = lane_bits(greater(load(group, VALID * LANES), broadcast(ZERO))) & in_use
        n_projected = keep_projected(group, candidates, k, valid, raw, projected, n_projected)
        kept = lane_bits(greater(load(group, KEEP * LANES), broadcast(ZERO))) & valid
        for i in range(U(LANES)):
            if k + LANES + np.int64(i) < end:  # its divisions run beside this lane's scalar work
                apply_steps(stale, candidates, k + LANES + np.int64(i))
            if (kept >> i) & U(1) == NONE:
                continue
            before = n_pairs
            box = box_of(boxes, i)
            if (box.right >> 4) == (box.left >> 4) or (box.bottom >> 4) == (box.top >> 4):
                n_pairs = list_box(box, tiles_x, n_pairs, tiles, tile_counts)
            else:
                n_pairs = list_tiles(ellipse_of(group, i), box, tiles_x, n_pairs, tiles, tile_counts)
                if n_pairs == before:
                    continue
            r = U(n_splats)
            for c in range(0, splat.FLOATS, LANES):
                store(flat_splats, r * U(splat.FLOATS) + U(c), load(rows, i * U(splat.FLOATS) + U(c)))
            pairs[r, U(0)], pairs[r, U(1)] = pair_tiles.first + before, pair_tiles.first + n_pairs
            gaussian_ids[r] = candidates[U(k) + i]
            keys[r] = float_bits(group[U(Z * LANES) + i])
            n_splats += 1
    return n_splats - first, n_pairs, n_projected - first, any_positive(has_nan)


@kernel(inline=True)
def apply_steps(stale, candidates, k):
    """Apply the deferred steps of the Gaussian candidates[k]."""
    rows, deferred = stale.rows, stale.deferred
    if deferred.now > stale.flushed:
        i = U(candidates[U(k)])
        if rows.clocks[i, U(1)] < deferred.now:
            apply_deferred(rows, i, i * U(rows.stride), deferred)


@kernel(inline=True)
def prefetch_group(parameters, stale, columns, candidates, k, end):
    """Prefetch what will be read of the Gaussians candidates[k …], LANES of them, before `end`."""
    for place in range(k, min(k + LANES, end)):
        i = int64(candidates[U(place)])
        if stale.deferred.now > stale.flushed:
            prefetch_gaussian(stale.rows, i)
        else:
            prefetch_columns(parameters.values, i, parameters.stride, 0, columns.used)


@kernel(inline=True)
def keep_projected(group, candidates, k, valid, raw, projected, n_projected):
    """Append the valid lanes (bits) to `projected`, which n_projected have reached; returns the new number.

    Image means are written where parameters are not raw: only then does anyone ask for them.
    """
    if valid == (U(1) << U(LANES)) - U(1) and raw:
        for lane in range(U(LANES)):
            projected.gaussian_ids[U(n_projected) + lane] = candidates[U(k) + lane]
        store_whole(projected.radii, n_projected, load(group, splat.RADIUS * LANES))
        return n_projected + LANES
    while valid != NONE:
        i, at = lowest(valid), U(n_projected)
        valid &= valid - U(1)
        projected.gaussian_ids[at] = candidates[U(k) + i]
        projected.radii[at] = np.int32(group[U(splat.RADIUS * LANES) + i])
        if not raw:
            projected.means2d[at, U(0)] = group[U(U_SINGLE * LANES) + i]
            projected.means2d[at, U(1)] = group[U(V_SINGLE * LANES) + i]
        n_projected += 1
    return n_projected


@kernel(inline=True)
def project_group(group, gathered, opacity_at, raw, camera, limits, has_nan):
    """Write the registers of the Gaussians in `gathered`, without colours; returns their means and has_nan.

    has_nan: a register, above zero in lanes that met a NaN. opacity_at: its column. raw: before activation.
    """
    footprint = footprint_of(gathered, raw, camera)
    opacity, log2_opacity = opacity_and_log2(gathered, opacity_at, raw)
    (x, y, z), (a, b, c), det = footprint.point, footprint.covariance, footprint.det
    one, zero = broadcast(ONE), broadcast(ZERO)
    # opacity and determinant carry what scales and quaternions hold
    has_nan = select(is_nan(z), one, select(is_nan(det), one, select(is_nan(opacity), one, has_nan)))
    valid = select(greater(z, broadcast(camera.near)), one, zero)
    valid = select(greater(broadcast(camera.far), z), valid, zero)
    valid = select(greater(det, zero), valid, zero)
    valid = select(greater(broadcast(F(np.inf)), det), valid, zero)
    keep = select(greater_equal(opacity, broadcast(limits.min_alpha)), valid, zero)
    u, v = x * footprint.rz * camera.fx + camera.cx, y * footprint.rz * camera.fy + camera.cy
    cut = log2_opacity - limits.log2_min_alpha
    # half the width and height, px, of the ellipse in which log2(alpha) is at most `cut` below that of the centre
    wide = square_root(maximum(TWO / LOG2_E * cut * a, zero))
    high = square_root(maximum(TWO / LOG2_E * cut * c, zero))
    inverse = divide(ONE, det)
    store(group, U_SINGLE * LANES, u)
    store(group, V_SINGLE * LANES, v)
    store(group, splat.A_ * LANES, -HALF * LOG2_E * c * inverse)
    store(group, splat.B_ * LANES, LOG2_E * b * inverse)
    store(group, splat.C_ * LANES, -HALF * LOG2_E * a * inverse)
    store(group, splat.LOG2_OPACITY * LANES, log2_opacity)
    store(group, splat.OPACITY * LANES, opacity)
    store(group, VALID * LANES, valid)
    store(group, KEEP * LANES, write_box(group, u, v, wide, high, keep, camera))
    store(group, Z * LANES, z)
    store(group, splat.RADIUS * LANES, screen_radius(a, c, det, u, v, camera))
    store(group, WIDE * LANES, wide)
    store(group, HIGH * LANES, high)
    store(group, SLOPE * LANES, divide(b * wide, a))
    store(group, CUT * LANES, cut)
    store(group, DET * LANES, det)
    exact_u, exact_v = exact_image_point(footprint.mean, camera)
    store(group, splat.U_ * LANES, narrow(exact_u - widen(load(group, splat.FIRST_X * LANES))))
    store(group, splat.V_ * LANES, narrow(exact_v - widen(load(group, splat.FIRST_Y * LANES))))
    return footprint.mean, has_nan


@kernel(inline=True)
def write_box(group, u, v, wide, high, keep, camera):
    """Write the first and last column and row of pixels of a box; returns `keep`, with zero for an empty one."""
    zero = broadcast(ZERO)
    left = maximum(u - wide - (HALF + SLACK), zero)
    right = minimum(u + wide - (HALF - SLACK), broadcast(camera.width - ONE))
    top = maximum(v - high - (HALF + SLACK), zero)
    bottom = minimum(v + high - (HALF - SLACK), broadcast(camera.height - ONE))
    x0, x1, y0, y1 = round_up(left), round_down(right), round_up(top), round_down(bottom)
    store(group, splat.FIRST_X * LANES, x0)
    store(group, LAST_X * LANES, x1)
    store(group, splat.FIRST_Y * LANES, y0)
    store(group, LAST_Y * LANES, y1)
    return select(greater_equal(y1, y0), select(greater_equal(x1, x0), keep, zero), zero)


@kernel(inline=True)
def write_channels(group, gathered, channels, mean, camera, basis):
    """Write the registers of the channels: colours as given (degree −1) or from spherical harmonics, and depth.

    basis (16 · LANES,) float32 is scratch.
    """
    if channels.degree < 0:
        for c in range(channels.colors):
            store(group, (splat.CHANNELS + c) * LANES, load(gathered, color_column(channels, 0, c) * LANES))
    else:
        x, y, z, _ = view_direction(mean, camera)
        write_basis(x, y, z, channels.degree, basis)
        for c in range(channels.colors):
            total = broadcast(HALF)
            for b in range((channels.degree + 1) * (channels.degree + 1)):
                total = total + load(basis, b * LANES) * load(gathered, color_column(channels, b, c) * LANES)
            dark = greater(broadcast(ZERO), total)  # not so for NaN, which must show
            store(group, (splat.CHANNELS + c) * LANES, select(dark, broadcast(ZERO), total))
    if channels.depth:
        store(group, (splat.CHANNELS + channels.colors) * LANES, load(group, Z * LANES))


@kernel(inline=True)
def box_of(boxes, i):
    """Box of lane i. boxes (4 · LANES,) int32: first column and row, then last column and row of all lanes, px."""
    return PixelBox(
        int64(boxes[i]), int64(boxes[U(2 * LANES) + i]), int64(boxes[U(LANES) + i]), int64(boxes[U(3 * LANES) + i])
    )


@kernel(inline=True)
def ellipse_of(group, i):
    """Ellipse of lane i."""
    return Ellipse(
        group[U(U_SINGLE * LANES) + i],
        group[U(V_SINGLE * LANES) + i],
        group[U(splat.A_ * LANES) + i],
        group[U(splat.B_ * LANES) + i],
        group[U(splat.C_ * LANES) + i],
        group[U(DET * LANES) + i],
        group[U(CUT * LANES) + i],
        group[U(WIDE * LANES) + i],
        group[U(HIGH * LANES) + i],
        group[U(SLOPE * LANES) + i],
    )

"""From Gaussians to splats, LANES at a time: project, colour, and list the tiles of each that can be visible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.harmonics import view_direction, write_basis
from tdgbench.splats.cpu.raster.projection import (
    LOG2_E,
    column,
    exact_image_point,
    footprint,
    opacity_and_log2,
    screen_radius,
)
from tdgbench.splats.cpu.raster.source import Source, Span
from tdgbench.splats.cpu.raster.splat import (
    A_,
    B_,
    C_,
    CHANNELS,
    FIRST_X,
    FLOATS,
    LOG2_OPACITY,
    OPACITY,
    RADIUS,
    U_,
    V_,
)  # fmt: skip
from tdgbench.splats.cpu.raster.tiles import SLACK, TILE, Box, Ellipse, list_tiles
from tdgbench.splats.cpu.raster.types import Projected, Settings, Splats
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.memory import aligned_floats, float_bits, load, store
from tdgbench.splats.cpu.simd.reductions import any_positive
from tdgbench.splats.cpu.simd.registers import (
    LANES,
    broadcast,
    divide,
    greater,
    greater_equal,
    is_nan,
    maximum,
    minimum,
    round_down,
    round_up,
    select,
    square_root,
)

F, U = np.float32, np.uint64
ZERO, HALF, ONE, TWO = F(0), F(0.5), F(1), F(2)
PAIRS_PER_CANDIDATE, MIN_PAIRS = 6, 4096  # first guess of the capacity for pairs
# Registers of one group of Gaussians, from the vector half of the kernel to its scalar half.
# 0 to 6 are as in a splat; the channels begin at COLOR.
VALID, KEEP, Z, SCREEN_RADIUS, WIDE, HIGH, SLOPE, CUT, DET, X0, X1, Y0, Y1 = range(7, 20)
COLOR, GROUP = 20, 24


class DepthOrder(NamedTuple):
    """Splats and their depths, to be sorted."""

    keys: np.ndarray  # (capacity,) uint32: bits of the camera-space z
    splat_ids: np.ndarray  # (capacity,) int32


class PairTiles(NamedTuple):
    """Tiles of one thread's pairs, which are numbered from `first`."""

    first: int
    tiles: np.ndarray  # (capacity,) int32


class Projection(NamedTuple):
    """Everything that projection leaves behind, for all threads."""

    projected: Projected
    projected_spans: list[Span]
    splats: Splats
    splat_spans: list[Span]
    order: DepthOrder
    pair_tiles: np.ndarray  # (pair capacity,) int32
    has_nan: bool  # in any Gaussian


def project(source: Source, settings: Settings, candidates: np.ndarray, spans: list[Span], kept: Workspace,
            passing: Workspace) -> Projection:  # fmt: skip
    """Project the spans of candidates (int32), a thread each. kept: memory that the backward pass reads again."""
    capacity = max(sum(n for _, n in spans), 1)
    splats = Splats(
        kept.take("splats", (capacity, FLOATS), np.float32),
        kept.take("gaussian ids", capacity, np.int32),
        kept.take("pairs", (capacity, 2), np.int32),
    )
    order = DepthOrder(passing.take("keys", capacity, np.uint32), passing.take("order", capacity, np.int32))
    projected = Projected(
        kept.take("projected", capacity, np.int32),
        kept.take("radii", capacity, np.int32),
        kept.take("means2d", (capacity, 2), np.float32),
    )
    shared = (source.parameters, settings.channels, settings.camera, settings.limits, splats, order, projected)
    pairs = max(MIN_PAIRS, PAIRS_PER_CANDIDATE * capacity // len(spans))
    while True:
        tiles = passing.take("tiles", (len(spans), pairs), np.int32)
        counts = np.zeros((len(spans), 4), np.int64)
        pool.run(
            project_and_list,
            [
                (*span, candidates, *shared, PairTiles(t * pairs, tiles[t]), counts[t])
                for t, span in enumerate(spans)
            ],
        )  # fmt: skip
        if counts[:, 1].max() <= pairs:
            break
        pairs = int(counts[:, 1].max())
    splat_spans, projected_spans = (
        [(first, int(n)) for (first, _), n in zip(spans, counts[:, column])] for column in (0, 2)
    )
    return Projection(
        projected, projected_spans, splats, splat_spans, order, tiles.reshape(-1), bool(counts[:, 3].any())
    )


@kernel()
def project_and_list(
    first, count, candidates, parameters, channels, camera, limits, splats, order, projected, pair_tiles, counts
):
    """Project candidates [first, first + count); rows of splats, order and projected are written from `first` on.

    candidates (n,) int32; the types of the others have their names. counts (4,) int64, written: splats, pairs,
    projected, whether anything is NaN. Pairs beyond the capacity are counted, not written.
    """
    tiles_x = (int64(camera.width) + TILE - 1) // TILE
    group, basis = aligned_floats(GROUP * LANES), aligned_floats(16 * LANES)
    has_nan = broadcast(ZERO)
    n_splats, n_projected, n_pairs = first, first, 0
    tiles, means = pair_tiles.tiles, parameters.means.values  # a reference in the loop costs an atomic operation
    for k in range(first, first + count, LANES):
        mean, has_nan = project_group(group, candidates, k, parameters, camera, limits, has_nan)
        write_colors(group, parameters.colors, candidates, k, channels, mean, camera, basis)
        for lane in range(min(LANES, first + count - k)):
            i = U(lane)
            if not (group[U(VALID * LANES) + i] > ZERO):
                continue
            at = U(n_projected)
            projected.gaussian_ids[at] = candidates[U(k) + i]
            projected.radii[at] = np.int32(group[U(SCREEN_RADIUS * LANES) + i])
            projected.means2d[at, U(0)] = group[U(U_ * LANES) + i]
            projected.means2d[at, U(1)] = group[U(V_ * LANES) + i]
            n_projected += 1
            if not (group[U(KEEP * LANES) + i] > ZERO):
                continue
            before = n_pairs
            box = box_of(group, i)
            n_pairs = list_tiles(ellipse_of(group, i), box, limits.loose, tiles_x, n_pairs, tiles)
            if n_pairs == before:
                continue
            r = U(n_splats)
            write_splat(splats.values, r, group, i, channels)
            splats.values[r, U(RADIUS)] = F(projected.radii[at])
            m = U(candidates[U(k) + i]) * U(parameters.means.stride) + U(parameters.means.first)
            exact_u, exact_v = exact_image_point(means[m], means[m + U(1)], means[m + U(2)], camera)
            splats.values[r, U(U_)], splats.values[r, U(V_)] = F(exact_u - box.left), F(exact_v - box.top)
            splats.pairs[r, U(0)], splats.pairs[r, U(1)] = pair_tiles.first + before, pair_tiles.first + n_pairs
            splats.gaussian_ids[r] = projected.gaussian_ids[at]
            order.keys[r] = float_bits(group[U(Z * LANES) + i])
            order.splat_ids[r] = n_splats
            n_splats += 1
    counts[0], counts[1], counts[2] = n_splats - first, n_pairs, n_projected - first
    counts[3] = any_positive(has_nan)


@kernel(inline=True)
def project_group(group, rows, k, parameters, camera, limits, has_nan):
    """Write the registers of the Gaussians rows[k …], without colours; returns their means and has_nan.

    has_nan: a register, above zero in lanes that met a NaN.
    """
    seen = footprint(parameters, rows, k, camera)
    opacity, log2_opacity = opacity_and_log2(parameters.opacities, rows, k, parameters.raw)
    (x, y, z), (a, b, c), det = seen.point, seen.covariance, seen.det
    one, zero = broadcast(ONE), broadcast(ZERO)
    # opacity and determinant carry what scales and quaternions hold
    has_nan = select(is_nan(z), one, select(is_nan(det), one, select(is_nan(opacity), one, has_nan)))
    valid = select(greater(z, broadcast(camera.near)), one, zero)
    valid = select(greater(broadcast(camera.far), z), valid, zero)
    valid = select(greater(det, zero), valid, zero)
    valid = select(greater(broadcast(F(np.inf)), det), valid, zero)
    keep = select(greater_equal(opacity, broadcast(limits.min_alpha)), valid, zero)
    u, v = x * seen.rz * camera.fx + camera.cx, y * seen.rz * camera.fy + camera.cy
    cut = log2_opacity - limits.log2_min_alpha
    wide, high = half_sides(a, c, det, cut, limits)
    inverse = divide(ONE, det)
    store(group, U_ * LANES, u)
    store(group, V_ * LANES, v)
    store(group, A_ * LANES, -HALF * LOG2_E * c * inverse)
    store(group, B_ * LANES, LOG2_E * b * inverse)
    store(group, C_ * LANES, -HALF * LOG2_E * a * inverse)
    store(group, LOG2_OPACITY * LANES, log2_opacity)
    store(group, OPACITY * LANES, opacity)
    store(group, VALID * LANES, valid)
    store(group, KEEP * LANES, write_box(group, u, v, wide, high, keep, camera))
    store(group, Z * LANES, z)
    store(group, SCREEN_RADIUS * LANES, screen_radius(a, c, det, u, v, camera))
    store(group, WIDE * LANES, wide)
    store(group, HIGH * LANES, high)
    store(group, SLOPE * LANES, divide(b * wide, a))
    store(group, CUT * LANES, cut)
    store(group, DET * LANES, det)
    return seen.mean, has_nan


@kernel(inline=True)
def half_sides(a, c, det, cut, limits):
    """Half the width and height, px, of the box in which log2(alpha) may be `cut` below that of the centre.

    Of the ellipse where alpha ≥ min_alpha, or with `loose` of the square around the cutoff.
    """
    wide = square_root(maximum(TWO / LOG2_E * cut * a, broadcast(ZERO)))
    high = square_root(maximum(TWO / LOG2_E * cut * c, broadcast(ZERO)))
    if limits.loose:
        middle = HALF * (a + c)
        longest = middle + square_root(maximum(middle * middle - det, broadcast(ZERO)))
        wide = limits.cutoff * square_root(longest)
        high = wide
    return wide, high


@kernel(inline=True)
def write_box(group, u, v, wide, high, keep, camera):
    """Write the first and last column and row of pixels of a box; returns `keep`, with zero for an empty one."""
    zero = broadcast(ZERO)
    left = maximum(u - wide - (HALF + SLACK), zero)
    right = minimum(u + wide - (HALF - SLACK), broadcast(camera.width - ONE))
    top = maximum(v - high - (HALF + SLACK), zero)
    bottom = minimum(v + high - (HALF - SLACK), broadcast(camera.height - ONE))
    x0, x1, y0, y1 = round_up(left), round_down(right), round_up(top), round_down(bottom)
    store(group, X0 * LANES, x0)
    store(group, X1 * LANES, x1)
    store(group, Y0 * LANES, y0)
    store(group, Y1 * LANES, y1)
    return select(greater_equal(y1, y0), select(greater_equal(x1, x0), keep, zero), zero)


@kernel(inline=True)
def write_colors(group, colors, rows, k, channels, mean, camera, basis):
    """Write the registers from COLOR on: colours as given (degree −1) or from spherical harmonics.

    basis (16 · LANES,) float32 is scratch.
    """
    if channels.degree < 0:
        for c in range(channels.colors):
            store(group, (COLOR + c) * LANES, column(colors, rows, k, c))
    else:
        x, y, z, _ = view_direction(mean, camera)
        write_basis(x, y, z, channels.degree, basis)
        for c in range(channels.colors):
            total = broadcast(HALF)
            for b in range((channels.degree + 1) * (channels.degree + 1)):
                total = total + load(basis, b * LANES) * column(colors, rows, k, b * channels.colors + c)
            dark = greater(broadcast(ZERO), total)  # not so for NaN, which must show
            store(group, (COLOR + c) * LANES, select(dark, broadcast(ZERO), total))


@kernel(inline=True)
def box_of(group, i):
    """Box of lane i."""
    return Box(
        int64(group[U(X0 * LANES) + i]),
        int64(group[U(X1 * LANES) + i]),
        int64(group[U(Y0 * LANES) + i]),
        int64(group[U(Y1 * LANES) + i]),
    )


@kernel(inline=True)
def ellipse_of(group, i):
    """Ellipse of lane i."""
    return Ellipse(
        group[U(U_ * LANES) + i],
        group[U(V_ * LANES) + i],
        group[U(A_ * LANES) + i],
        group[U(B_ * LANES) + i],
        group[U(C_ * LANES) + i],
        group[U(DET * LANES) + i],
        group[U(CUT * LANES) + i],
        group[U(WIDE * LANES) + i],
        group[U(HIGH * LANES) + i],
        group[U(SLOPE * LANES) + i],
    )


@kernel(inline=True)
def write_splat(splats, r, group, i, channels):
    """Row r of splats (n, 16) from lane i, but for mean and radius."""
    for j in range(U(A_), U(7)):
        splats[r, j] = group[j * U(LANES) + i]
    for c in range(U(channels.colors)):
        splats[r, U(CHANNELS) + c] = group[(U(COLOR) + c) * U(LANES) + i]
    if channels.depth:
        splats[r, U(CHANNELS + channels.colors)] = group[U(Z * LANES) + i]
    for j in range(U(4)):
        splats[r, U(FIRST_X) + j] = group[(U(X0) + j) * U(LANES) + i]

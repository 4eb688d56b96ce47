"""From Gaussians to splats, LANES at a time: project, colour, and list the tiles of each that can be visible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.columns import COLORS_AT
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import apply_deferred, prefetch_gaussian
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blocks import NONE, lowest
from tdgbench.splats.cpu.raster.group import (
    GROUP,
    KEEP,
    U_SINGLE,
    V_SINGLE,
    VALID,
    Z,
    box_of,
    copy_splat,
    ellipse_of,
    project_group,
    turn_splats,
    write_boxes,
    write_channels,
)
from tdgbench.splats.cpu.raster.parameters import GATHERED, collect
from tdgbench.splats.cpu.raster.source import GaussianSource, Span
from tdgbench.splats.cpu.raster.tiles import TILE, list_box, list_tiles
from tdgbench.splats.cpu.raster.types import FLOATS, RADIUS, Projected, Settings, Splats
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.memory import aligned_floats, float_bits, load, prefetch_columns, store_whole
from tdgbench.splats.cpu.simd.reductions import any_positive, lane_bits
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, greater

F, U = np.float32, np.uint64
ZERO = F(0)
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
        workspace.take("splats", (capacity, FLOATS), np.float32),
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
    rows, boxes = aligned_floats(FLOATS * LANES), np.zeros(4 * LANES, np.int32)
    has_nan = broadcast(ZERO)
    n_splats, n_projected, n_pairs = first, first, int64(0)  # for a literal, helpers would be compiled once more
    # a reference in the loop costs an atomic operation
    tiles, tile_counts = pair_tiles.tiles, pair_tiles.counts
    flat_splats, pairs = splats.values.reshape(-1), splats.pairs
    gaussian_ids, keys = splats.gaussian_ids, splats.depth_keys
    bases = (channels.degree + 1) * (channels.degree + 1) if channels.degree >= 0 else 1
    end = first + count
    for k in range(first, min(first + LANES, end)):
        apply_steps(stale, candidates, k)
    for k in range(first, end, LANES):
        prefetch_group(parameters, stale, bases * channels.colors, candidates, k + PREFETCH_DISTANCE, end)
        collect(parameters, candidates, k, bases * channels.colors, gathered)
        mean, has_nan = project_group(group, gathered, raw, camera, limits, has_nan)
        write_channels(group, gathered, channels, mean, camera, basis)
        turn_splats(group, rows)
        write_boxes(group, boxes)
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
            copy_splat(rows, i, flat_splats, r)
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
def prefetch_group(parameters, stale, colors, candidates, k, end):
    """Prefetch what will be read of the Gaussians candidates[k …], LANES of them, before `end`."""
    for place in range(k, min(k + LANES, end)):
        i = int64(candidates[U(place)])
        if stale.deferred.now > stale.flushed:
            prefetch_gaussian(stale.rows, i)
        else:
            prefetch_columns(parameters.values, i, parameters.stride, 0, COLORS_AT + colors)


@kernel(inline=True)
def keep_projected(group, candidates, k, valid, raw, projected, n_projected):
    """Append the valid lanes (bits) to `projected`, which n_projected have reached; returns the new number.

    Image means are written where parameters are not raw: only then does anyone ask for them.
    """
    if valid == (U(1) << U(LANES)) - U(1) and raw:
        for lane in range(U(LANES)):
            projected.gaussian_ids[U(n_projected) + lane] = candidates[U(k) + lane]
        store_whole(projected.radii, n_projected, load(group, RADIUS * LANES))
        return n_projected + LANES
    while valid != NONE:
        i, at = lowest(valid), U(n_projected)
        valid &= valid - U(1)
        projected.gaussian_ids[at] = candidates[U(k) + i]
        projected.radii[at] = np.int32(group[U(RADIUS * LANES) + i])
        if not raw:
            projected.means2d[at, U(0)] = group[U(U_SINGLE * LANES) + i]
            projected.means2d[at, U(1)] = group[U(V_SINGLE * LANES) + i]
        n_projected += 1
    return n_projected

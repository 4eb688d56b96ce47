"""From Gaussians to splats, LANES at a time: project, colour, and list the tiles of each that can be visible."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import int64

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.group import (
    GROUP,
    KEEP,
    SCREEN_RADIUS,
    VALID,
    Z,
    box_of,
    ellipse_of,
    project_group,
    write_colors,
    write_splat,
)
from tdgbench.splats.cpu.raster.projection import exact_image_point
from tdgbench.splats.cpu.raster.source import Source, Span
from tdgbench.splats.cpu.raster.splat import FLOATS, RADIUS, U_, V_
from tdgbench.splats.cpu.raster.tiles import TILE, list_tiles
from tdgbench.splats.cpu.raster.types import Projected, Settings, Splats
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.memory import aligned_floats, float_bits
from tdgbench.splats.cpu.simd.reductions import any_positive
from tdgbench.splats.cpu.simd.registers import LANES, broadcast

F, U = np.float32, np.uint64
ZERO = F(0)
PAIRS_PER_CANDIDATE, MIN_PAIRS = 6, 4096  # first guess of the capacity for pairs


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


def project(source: Source, settings: Settings, candidates: np.ndarray, spans: list[Span], workspace: Workspace,
            scratch: Workspace) -> Projection:  # fmt: skip
    """Project the spans of candidates (int32), a thread each. workspace: memory that the backward pass reads again."""
    capacity = max(sum(n for _, n in spans), 1)
    splats = Splats(
        workspace.take("splats", (capacity, FLOATS), np.float32),
        workspace.take("gaussian ids", capacity, np.int32),
        workspace.take("pairs", (capacity, 2), np.int32),
    )
    order = DepthOrder(scratch.take("keys", capacity, np.uint32), scratch.take("order", capacity, np.int32))
    projected = Projected(
        workspace.take("projected", capacity, np.int32),
        workspace.take("radii", capacity, np.int32),
        workspace.take("means2d", (capacity, 2), np.float32),
    )
    shared = (source.parameters, settings.channels, settings.camera, settings.limits, splats, order, projected)
    pairs = max(MIN_PAIRS, PAIRS_PER_CANDIDATE * capacity // len(spans))
    while True:
        tiles = scratch.take("tiles", (len(spans), pairs), np.int32)
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

"""The two passes over one camera: forward from Gaussians to an image, backward from its gradient to theirs.

Gaussians are cut into as many pieces as there are threads; a piece's candidates, records and gradient rows stand at its
own place in arrays that all pieces share. Orders and sums do not depend on the pieces, so neither do results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tdgbench.splats.columns import COLORS_AT, padded
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.blend import make_blend
from tdgbench.splats.cpu.raster.blend_backward import make_blend_backward, slot_size
from tdgbench.splats.cpu.raster.blocks import GRID
from tdgbench.splats.cpu.raster.culling import find_candidates
from tdgbench.splats.cpu.raster.limits import REACH
from tdgbench.splats.cpu.raster.projection_backward import projection_backward
from tdgbench.splats.cpu.raster.projection_forward import project_and_list
from tdgbench.splats.cpu.raster.records import RECORD
from tdgbench.splats.cpu.raster.tiles import TILE, list_by_tile, sort_by_key
from tdgbench.splats.cpu.scratch import Lease
from tdgbench.splats.cpu.simd.powers import COEFFICIENTS
from tdgbench.splats.cpu.simd.registers import LANES

F = np.float32


@dataclass(frozen=True)
class Settings:
    """What a rendering needs besides Gaussians."""

    camera: np.ndarray  # float32 (27,), see tdgbench.splats.cpu.raster.projection
    width: int
    height: int
    degree: int  # −1: colours as they are
    depth_channel: bool
    background: np.ndarray  # float32 (colours,)
    limits: np.ndarray  # float32 (7,), see tdgbench.splats.cpu.raster.limits


@dataclass(frozen=True)
class Source:
    """Where the kernels find N Gaussians: flat float32 arrays, each with a stride and a first column."""

    count: int
    arrays: tuple[np.ndarray, ...]  # means, scales, quats, opacities, colours
    layout: np.ndarray  # int64 (10,): stride and first column of each
    raw: bool  # scales and opacities stand before their activations
    sizes: tuple[np.ndarray, int, int, int]  # deviations to cull by: array, stride, first column, how many
    centres: tuple[np.ndarray, int, int]  # means to cull by: array, stride, first column
    slack: float = 0.0  # how far a mean may be from `centres`
    growth: float = 0.0  # by how much the logarithm of a deviation may be above `sizes`
    update: Callable[[list[tuple[int, int]], np.ndarray], None] | None = None  # make these candidates current


@dataclass
class Projected:
    """What a camera may see, piece by piece: (first, count) into shared arrays."""

    seen: list[tuple[int, int]]
    index: np.ndarray  # (room,) int32: the Gaussian
    radii: np.ndarray  # (room,) int32 px
    means2d: np.ndarray  # (room, 2) px


@dataclass
class ForwardPass:
    """An image, and what the backward pass needs again."""

    image: np.ndarray  # (H, W, colours)
    depth: np.ndarray  # (H, W), or empty
    transmittance: np.ndarray  # (H, W)
    projected: Projected
    records: np.ndarray  # (room, 16)
    owners: np.ndarray  # (room,): a record's Gaussian
    pairs: np.ndarray  # (room, 2): a record's first (tile, Gaussian) pair, and the end
    kept: list[tuple[int, int]]  # records, piece by piece
    pair_room: int  # ids of pairs lie below
    tile_start: np.ndarray  # (tiles + 1,)
    gaussian_of: np.ndarray  # (pairs,): the record
    slot_of: np.ndarray  # (pairs,)
    reached: np.ndarray  # (tiles,): how many pairs were looked at
    lit: np.ndarray  # (pairs,) uint32: in which blocks of its tile a pair has any weight, if it was looked at
    lease: Lease  # owns the arrays above

    def count_pairs(self) -> int:
        return len(self.gaussian_of)


@dataclass
class GradientRows:
    """Gradients of the Gaussians that some pixel looked at, piece by piece; columns as in `tdgbench.splats.columns`."""

    pieces: list[tuple[int, int]]  # (first, count) of rows
    index: np.ndarray  # (room,) int32: the Gaussian
    values: np.ndarray  # (room, columns)
    image: np.ndarray  # (room, 3): d/du, d/dv, radius
    lease: Lease


def forward(source: Source, settings: Settings) -> ForwardPass:
    """Cull, project, list and blend."""
    threads = pool.get_threads()
    lease, passing = Lease(), Lease()  # what the backward pass needs again, and what it does not
    n_groups = -(-source.count // LANES)
    pieces = [
        (a * LANES, min(b * LANES, source.count)) for a, b in pool.chunks(n_groups, min(threads, max(n_groups, 1)))
    ]
    candidates = passing.take("candidates", max(n_groups, 1) * LANES, np.int32)
    growing, reach = (F(source.slack), F(source.growth)), settings.limits[REACH]
    where = (*source.centres, *source.sizes, source.raw, *growing, settings.camera, reach, candidates)
    found = pool.run(find_candidates, [(*piece, *where) for piece in pieces])
    # The candidates of all pieces together are cut anew, so that each thread projects as many as the others.
    spans = _pack(candidates, [(a, n) for (a, _), n in zip(pieces, found)], threads)
    if source.update is not None:
        source.update(spans, candidates)
    return _project_and_blend(source, settings, candidates, spans, lease, passing)


def _pack(candidates: np.ndarray, found: list[tuple[int, int]], threads: int) -> list[tuple[int, int]]:
    """Close the gaps between pieces in place; cut the whole into equal spans (first, count) on register bounds."""
    total = 0
    for first, count in found:
        if first != total:
            candidates[total : total + count] = candidates[first : first + count]
        total += count
    groups = -(-total // LANES)
    candidates[total : groups * LANES] = candidates[total - 1] if total else 0
    cuts = pool.chunks(groups, min(threads, max(groups, 1)))
    return [(a * LANES, min(b * LANES, total) - a * LANES) for a, b in cuts]


def _project_and_blend(source, settings, candidates, spans, lease, passing) -> ForwardPass:
    n_tiles = -(-settings.width // TILE) * -(-settings.height // TILE)
    room = max(sum(n for _, n in spans), 1)
    records = lease.take("records", (room, RECORD), np.float32)
    owners, pairs = lease.take("owners", room, np.int32), lease.take("pairs", (room, 2), np.int32)
    keys, order = passing.take("keys", room, np.uint32), passing.take("order", room, np.int32)
    index, radii = lease.take("seen", room, np.int32), lease.take("radii", room, np.int32)
    means2d = lease.take("means2d", (room, 2), np.float32)
    channels = len(settings.background)
    pair_room = max(4096, 6 * room // len(spans))
    while True:
        tile_of_pair = passing.take("tiles", (len(spans), pair_room), np.int32)
        counts = np.zeros((len(spans), 4), np.int64)
        pool.run(
            project_and_list,
            [
                (
                    *span, candidates, *source.arrays, source.layout, source.raw, channels, settings.degree,
                    settings.camera, settings.limits, settings.depth_channel, t * pair_room, records, owners, pairs,
                    keys, order, index, radii, means2d, tile_of_pair[t], counts[t],
                )
                for t, span in enumerate(spans)
            ],
        )  # fmt: skip
        if counts[:, 1].max() <= pair_room:
            break
        pair_room = int(counts[:, 1].max())
    firsts = [first for first, _ in spans]
    kept = list(zip(firsts, counts[:, 0].tolist()))
    spare = [
        (passing.take("keys", room, np.uint32), passing.take("order", room, np.int32)) for _ in range(2)
    ]  # fmt: skip
    _, sorted_records = sort_by_key([(a, a + n) for a, n in kept], keys, order, spare)
    tile_start, gaussian_of, slot_of = list_by_tile(
        sorted_records, pairs, tile_of_pair.reshape(-1), n_tiles, lease.take
    )
    lit = lease.take("lit", len(gaussian_of), np.uint32)
    image, depth, transmittance, reached = blend(settings, records, tile_start, gaussian_of, lit)
    if counts[:, 3].any():  # nobody can say where that Gaussian would have been
        for result in (image, depth, transmittance):
            result[:] = np.nan
    projected = Projected(list(zip(firsts, counts[:, 2].tolist())), index, radii, means2d)
    return ForwardPass(
        image, depth, transmittance, projected, records, owners, pairs, kept, len(spans) * pair_room,
        tile_start, gaussian_of, slot_of, reached, lit, lease,
    )  # fmt: skip


def blend(settings: Settings, records, tile_start, gaussian_of, lit) -> tuple[np.ndarray, ...]:
    """Image, depth (empty if not asked for), transmittance, and how many pairs of each tile were looked at."""
    size, channels = (settings.height, settings.width), len(settings.background)
    image = np.empty((*size, channels), np.float32)
    depth = np.empty(size if settings.depth_channel else (0, 0), np.float32)
    transmittance, reached = np.empty(size, np.float32), np.empty(len(tile_start) - 1, np.int32)
    arguments = (
        np.zeros(1, np.int64), settings.width, settings.height, records, tile_start, gaussian_of,
        settings.background, settings.limits, COEFFICIENTS, GRID,
        image, depth, transmittance, reached, lit,
    )  # fmt: skip
    pool.run(make_blend(channels, settings.depth_channel), [arguments] * pool.get_threads())
    return image, depth, transmittance, reached


def backward(
    source: Source, settings: Settings, done: ForwardPass, grad_image, grad_depth, grad_transmittance
) -> GradientRows:
    """Gradients of the parameters from those of image, depth and transmittance (None: zero)."""
    channels = len(settings.background)
    gradients = [
        np.zeros_like(like) if grad is None else np.ascontiguousarray(grad)
        for grad, like in (
            (grad_image, done.image), (grad_depth, done.depth), (grad_transmittance, done.transmittance),
        )
    ]  # fmt: skip
    lease, passing = Lease(), Lease()
    size = slot_size(channels + settings.depth_channel)
    slots, written = passing.take("slots", done.pair_room * size, np.float32), np.zeros(done.pair_room, np.bool_)
    arguments = (
        np.zeros(1, np.int64), settings.width, settings.height, done.records, done.tile_start,
        done.gaussian_of, done.slot_of, settings.limits, COEFFICIENTS, GRID,
        done.image, done.depth, done.transmittance, *gradients, done.reached, done.lit, slots, written,
    )  # fmt: skip
    variant = make_blend_backward(channels, settings.depth_channel)
    pool.run(variant, [arguments] * pool.get_threads())
    bases = (settings.degree + 1) ** 2 if settings.degree >= 0 else 1
    stride = padded(COLORS_AT + bases * channels)
    room = -(-len(done.records) // LANES) * LANES
    values = lease.take("gradients", (room, stride), np.float32)
    image = lease.take("image gradients", (room, 3), np.float32)
    index = lease.take("touched", room, np.int32)
    touched = pool.run(
        projection_backward,
        [
            (
                *piece, done.owners, *source.arrays, source.layout, source.raw, channels, settings.degree,
                settings.camera, settings.depth_channel, done.records, done.pairs, slots, written, size,
                stride, index, values, image,
            )
            for piece in done.kept
        ],
    )  # fmt: skip
    pieces = [(first, count) for (first, _), count in zip(done.kept, touched)]
    return GradientRows(pieces, index, values, image, lease)

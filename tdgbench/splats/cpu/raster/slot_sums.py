"""Sums over the gradient slots of each splat, for a batch of splats that some pixel depends on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import COLORS_AT
from tdgbench.splats.cpu.adam import prefetch_gaussian
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blend_backward import MOMENTS
from tdgbench.splats.cpu.simd.memory import load_anywhere, prefetch, prefetch_columns, prefetch_row, store, turn_block
from tdgbench.splats.cpu.simd.reductions import lane_bits
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, is_nonzero

F, U = np.float32, np.uint64
SLOT = 16  # floats: a slot of six moments, up to four channels and two absolute sums, in whole registers
BATCH = 4 * LANES  # splats whose memory is fetched before it is read


class Batch(NamedTuple):
    """Splats with a gradient."""

    sums: np.ndarray  # (BATCH · SLOT,) float32: sums over each splat's slots
    splat_ids: np.ndarray  # (BATCH,) int32
    gaussian_ids: np.ndarray  # (BATCH,) int32


@kernel(inline=True)
def fill_batch(batch, r, end, splats, slots, parameters, channels, step):
    """Fill the batch from splats [r, end); returns the number of splats in it and the first one that was not looked at.

    A batch that ends within a register is filled up with its last splat. What will be read of a Gaussian is prefetched;
    the arguments are those of `projection_backward`.
    """
    floats, filled = MOMENTS + channels.colors + channels.depth + 2 * channels.absgrad, 0
    pairs, written, values = splats.pairs, slots.written, slots.values
    while r < end and filled < BATCH:
        low, high = broadcast(F(0)), broadcast(F(0))  # high: beyond the first register
        for slot in range(pairs[U(r), U(0)], pairs[U(r), U(1)]):
            if written[U(slot)]:
                at = U(slot) * U(floats)
                low = low + load_anywhere(values, at)
                if LANES < SLOT:
                    high = high + load_anywhere(values, at + U(LANES))
        found = lane_bits(is_nonzero(low))
        if LANES < SLOT:
            found |= lane_bits(is_nonzero(high)) << U(LANES)
        if found & ((U(1) << U(floats)) - U(1)) != U(0):
            at = U(filled * SLOT)
            store(batch.sums, at, low)
            if LANES < SLOT:
                store(batch.sums, at + U(LANES), high)
            batch.splat_ids[U(filled)] = r
            gaussian = splats.gaussian_ids[U(r)]
            batch.gaussian_ids[U(filled)] = gaussian
            prefetch_parameters(parameters, channels, step, np.int64(gaussian))
            filled += 1
        r += 1
    if filled > 0:
        for lane in range(filled, (filled + LANES - 1) // LANES * LANES):
            batch.splat_ids[U(lane)] = batch.splat_ids[U(filled - 1)]
            batch.gaussian_ids[U(lane)] = batch.gaussian_ids[U(filled - 1)]
    return filled, r


@kernel(inline=True)
def prefetch_parameters(parameters, channels, step, i):
    """Prefetch what will be read of Gaussian i."""
    if not step.active:
        n_bases = (channels.degree + 1) * (channels.degree + 1) if channels.degree >= 0 else 1
        prefetch_columns(parameters.values, i, parameters.stride, 0, COLORS_AT + n_bases * channels.colors)
    else:
        prefetch_gaussian(step.step.rows, i)
        prefetch_row(step.step.rows.bounds, U(i))
        prefetch(step.statistics.grad_sum, U(i))


@kernel(inline=True)
def turn_sums(batch, first, totals):
    """totals (SLOT · LANES,) float32: the sums of splats [first, first + LANES) of the batch, a register each."""
    for c in range(0, SLOT, LANES):
        turn_block(batch.sums, first * SLOT + c, SLOT, totals, c * LANES, LANES)

"""From a Gaussian's gradient slots back to its parameters: blend moments → 2-D Gaussian → EWA → mean, scale, rotation.

The derivatives are exact, those of the clamped ray included (3DGS's CUDA code treats the clamp as a constant). Only
Gaussians that some pixel depends on get gradients; LANES of them are worked on at a time. The gradients are written to
rows, or go straight into a step of Adam.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.cpu.adam import NO_STEP, AdamStep, prefetch_gaussian, step_row
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blend_backward import MOMENTS
from tdgbench.splats.cpu.raster.ewa_gradient import ellipse_gradient, outer, point_gradient, quaternion_gradient
from tdgbench.splats.cpu.raster.projection import GATHERED, collect, color_column, footprint_of
from tdgbench.splats.cpu.raster.sh_registers import direction_gradient, view_direction, write_basis
from tdgbench.splats.cpu.raster.types import CHANNELS, FLOATS, OPACITY, RADIUS, GradientArrays
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    gather,
    load,
    load_anywhere,
    prefetch,
    prefetch_columns,
    prefetch_row,
    put_column,
    store,
    turn_block,
)
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, greater, is_nonzero, lane_bits, select
from tdgbench.splats.cpu.statistics import NO_STATISTICS, StatisticsArrays, add_length
from tdgbench.splats.gaussians import MEANS_AT, QUATS_AT, SCALES_AT

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)
IMAGE_U, IMAGE_V, IMAGE_RADIUS, IMAGE_ABSOLUTE_U, IMAGE_ABSOLUTE_V = range(5)  # registers of `image`
SLOT = 16  # floats: a slot of six moments, up to six channels and two absolute sums, in whole registers
BATCH = 4 * LANES  # splats whose memory is fetched before it is read


class Batch(NamedTuple):
    """Splats with a gradient."""

    sums: np.ndarray  # (BATCH · SLOT,) float32: sums over each splat's slots
    splat_ids: np.ndarray  # (BATCH,) int32
    gaussian_ids: np.ndarray  # (BATCH,) int32


class FusedStep(NamedTuple):
    """A step of Adam, and density control's statistics, that the gradients go into."""

    step: AdamStep
    statistics: StatisticsArrays
    bad: np.ndarray  # (stride,) float32: becomes 1 in columns with a gradient that is not finite
    active: bool = True


NO_FUSED_STEP = FusedStep(NO_STEP, NO_STATISTICS, np.zeros(0, np.float32), False)
NO_ROWS = GradientArrays(np.zeros(0, np.int32), np.zeros((0, 0), np.float32), np.zeros((0, 3), np.float32))


class GradientScratch(NamedTuple):
    """A thread's buffers for one group of LANES splats; they hold registers."""

    gathered: np.ndarray  # (GATHERED · LANES,) float32: parameters
    totals: np.ndarray  # (SLOT · LANES,) float32: sums over each splat's slots
    basis: np.ndarray  # (16 · LANES,) float32: spherical harmonics
    pull: np.ndarray  # (16 · LANES,) float32: gradients of the basis functions
    gradient: np.ndarray  # (GATHERED · LANES,) float32: by column; those not in use stay 0
    image: np.ndarray  # (5 · LANES,) float32: gradient of the image mean, screen radius, absolute gradients
    rows: np.ndarray  # (GATHERED · LANES,) float32: the gradients row by row


@kernel()
def projection_backward(first, count, parameters, channels, camera, splats, slots, rows, step):
    """Gradients of splats [first, first + count), for those that have any; returns how many Gaussians that is.

    Arguments are of the types that have their names. rows: GradientArrays, written from `first` on; or step: FusedStep,
    taken where it is active.
    """
    basis, pull, image = aligned_floats(16 * LANES), aligned_floats(16 * LANES), aligned_floats(5 * LANES)
    gathered, gradient = aligned_floats(GATHERED * LANES), aligned_floats(GATHERED * LANES)
    totals, out = aligned_floats(SLOT * LANES), aligned_floats(GATHERED * LANES)
    scratch = GradientScratch(gathered, totals, basis, pull, gradient, image, out)
    batch = Batch(aligned_floats(BATCH * SLOT), np.zeros(BATCH, np.int32), np.zeros(BATCH, np.int32))
    written, r = first, first
    while r < first + count:
        filled, r = fill_batch(batch, r, first + count, splats, slots, parameters, channels, step)
        for k in range(0, filled, LANES):
            collect(parameters, batch.gaussian_ids, k, channels.columns, scratch.gathered)
            for c in range(0, SLOT, LANES):
                turn_block(batch.sums, k * SLOT + c, SLOT, scratch.totals, c * LANES, LANES)
            write_gradient(parameters.raw, channels, camera, splats.values, batch.splat_ids, k, scratch)
            if step.active:
                step_group(batch.gaussian_ids, k, min(filled - k, LANES), scratch, step)
            else:
                write_rows(batch.gaussian_ids, k, scratch, written + k, rows)
        written += filled
    return written - first


@kernel(inline=True)
def write_rows(gaussian_ids, k, scratch, written, rows):
    """Write a group's gradients to rows written, written + 1, … of GradientArrays."""
    stride = rows.values.shape[1]
    for lane in range(LANES):
        rows.gaussian_ids[U(written + lane)] = gaussian_ids[U(k + lane)]
    for c in range(0, stride, LANES):
        turn_block(scratch.gradient, c * LANES, LANES, rows.values, written * stride + c, stride)
    width = rows.image.shape[1]
    for c in range(width):
        put_column(rows.image, written, width, c, load(scratch.image, c * LANES))


@kernel(inline=True)
def step_group(gaussian_ids, k, count, scratch, step):
    """Take the step of a group's first `count` Gaussians."""
    statistics, image = step.statistics, scratch.image
    columns = (step.step.rows.columns + LANES - 1) // LANES * LANES
    for c in range(0, columns, LANES):
        turn_block(scratch.gradient, c * LANES, LANES, scratch.rows, c, columns)
    for lane in range(U(count)):
        i = U(gaussian_ids[U(k) + lane])
        step_row(step.step, i, scratch.rows, lane * U(columns), step.bad)
        if statistics.active and image[U(IMAGE_RADIUS * LANES) + lane] > ZERO:
            u, v = image[U(IMAGE_U * LANES) + lane], image[U(IMAGE_V * LANES) + lane]
            add_length(statistics, statistics.grad_sum, i, u, v)
            if statistics.absolute_sum.size > 0:
                u, v = image[U(IMAGE_ABSOLUTE_U * LANES) + lane], image[U(IMAGE_ABSOLUTE_V * LANES) + lane]
                add_length(statistics, statistics.absolute_sum, i, u, v)


@kernel(inline=True)
def write_gradient(raw, channels, camera, splats, splat_ids, k, scratch):
    """Write the gradients of the group in `scratch`, splats splat_ids[k …], to its `gradient` and `image`.

    raw: gradients of parameters before activation. splats (n, 16) float32.
    """
    totals, out, image = scratch.totals, scratch.gradient, scratch.image
    footprint = footprint_of(scratch.gathered, raw, camera)
    scales = footprint.scales
    opacity = gather(splats, splat_ids, k, FLOATS, OPACITY)
    t0, opacity_at = load(totals, 0), channels.columns.opacity * LANES
    if raw:
        store(out, opacity_at, t0 * (ONE - opacity))
    else:
        store(out, opacity_at, divide(t0, opacity))

    gp, gq, g_scales, g_mean2d = ellipse_gradient(totals, footprint, camera.eps2d)
    store(image, IMAGE_U * LANES, g_mean2d[0])
    store(image, IMAGE_V * LANES, g_mean2d[1])
    store(image, IMAGE_RADIUS * LANES, gather(splats, splat_ids, k, FLOATS, RADIUS))
    if channels.absgrad:
        at = (MOMENTS + channels.colors + channels.depth) * LANES
        store(image, IMAGE_ABSOLUTE_U * LANES, load(totals, at))
        store(image, IMAGE_ABSOLUTE_V * LANES, load(totals, at + LANES))
    if raw:
        g_scales = (g_scales[0] * scales[0], g_scales[1] * scales[1], g_scales[2] * scales[2])
    put_three(out, SCALES_AT, g_scales)
    rows = outer(footprint.ja, footprint.jb, gp, gq)
    g_w, g_xyz = quaternion_gradient(footprint.quat, footprint.per_length, rows)
    store(out, QUATS_AT * LANES, g_w)
    put_three(out, QUATS_AT + 1, g_xyz)

    gx, gy, gz = point_gradient(footprint, gp, gq, g_mean2d, camera)
    if channels.depth:
        gz = gz + load(totals, (MOMENTS + channels.colors) * LANES)
    g_mean = (
        gx * camera.x_axis[0] + gy * camera.y_axis[0] + gz * camera.z_axis[0],
        gx * camera.x_axis[1] + gy * camera.y_axis[1] + gz * camera.z_axis[1],
        gx * camera.x_axis[2] + gy * camera.y_axis[2] + gz * camera.z_axis[2],
    )
    if channels.degree < 0:
        for c in range(channels.colors):
            store(out, color_column(channels, 0, c) * LANES, load(totals, (MOMENTS + c) * LANES))
    else:
        g_mean = harmonics_gradient(g_mean, footprint.mean, channels, camera, splats, splat_ids, k, scratch)
    put_three(out, MEANS_AT, g_mean)


@kernel(inline=True)
def put_three(out, first_column, vector):
    """Put a vector into columns first_column, + 1, + 2."""
    store(out, first_column * LANES, vector[0])
    store(out, (first_column + 1) * LANES, vector[1])
    store(out, (first_column + 2) * LANES, vector[2])


@kernel(inline=True)
def harmonics_gradient(g_mean, mean, channels, camera, splats, splat_ids, k, scratch):
    """Write the gradients of the coefficients; returns that of the mean, with the part of the viewing direction.

    Arguments as those of `write_gradient`.
    """
    n_bases = (channels.degree + 1) * (channels.degree + 1)
    vx, vy, vz, per_distance = view_direction(mean, camera)
    write_basis(vx, vy, vz, channels.degree, scratch.basis)
    for b in range(n_bases):
        store(scratch.pull, b * LANES, broadcast(ZERO))
    for c in range(channels.colors):
        positive = greater(gather(splats, splat_ids, k, FLOATS, CHANNELS + c), broadcast(ZERO))  # else clamped
        g = select(positive, load(scratch.totals, (MOMENTS + c) * LANES), broadcast(ZERO))
        for b in range(n_bases):
            at = color_column(channels, b, c) * LANES
            store(scratch.gradient, at, load(scratch.basis, b * LANES) * g)
            coefficient = load(scratch.gathered, at)
            store(scratch.pull, b * LANES, load(scratch.pull, b * LANES) + coefficient * g)
    gx, gy, gz = g_mean
    if channels.degree > 0:
        gdx, gdy, gdz = direction_gradient(vx, vy, vz, channels.degree, scratch.pull)
        along = gdx * vx + gdy * vy + gdz * vz
        gx = gx + (gdx - along * vx) * per_distance
        gy = gy + (gdy - along * vy) * per_distance
        gz = gz + (gdz - along * vz) * per_distance
    return gx, gy, gz


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
        prefetch_columns(parameters.values, i, parameters.stride, 0, channels.columns.used)
    else:
        prefetch_gaussian(step.step.rows, i)
        prefetch_row(step.step.rows.bounds, U(i))
        prefetch(step.statistics.grad_sum, U(i))

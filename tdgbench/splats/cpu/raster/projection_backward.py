"""From a Gaussian's gradient slots back to its parameters: blend moments → 2-D Gaussian → EWA → mean, scale, rotation.

The derivatives are exact, those of the clamped ray included (3DGS's CUDA code treats the clamp as a constant). Only
Gaussians that some pixel depends on get a row of gradients; LANES of them are worked on at a time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blend_backward import MOMENTS
from tdgbench.splats.cpu.raster.ewa_gradient import ellipse_gradient, outer, point_gradient, quaternion_gradient
from tdgbench.splats.cpu.raster.harmonics import direction_gradient, view_direction, write_basis
from tdgbench.splats.cpu.raster.parameters import column
from tdgbench.splats.cpu.raster.projection import footprint_of
from tdgbench.splats.cpu.raster.splat import CHANNELS, FLOATS, OPACITY, RADIUS
from tdgbench.splats.cpu.simd.memory import (
    aligned_floats,
    gather,
    load,
    prefetch,
    prefetch_columns,
    put_column,
    store,
)
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, greater, select

F, U = np.float32, np.uint64
ZERO, ONE = F(0), F(1)
PREFETCH_DISTANCE = 16  # splats
MAX_SLOT = MOMENTS + 4  # floats


class Scratch(NamedTuple):
    """A thread's buffers for one group of LANES splats; float32 ones hold registers."""

    totals: np.ndarray  # (MAX_SLOT · LANES,) float32: sums over each splat's slots
    basis: np.ndarray  # (16 · LANES,) float32: spherical harmonics
    pull: np.ndarray  # (16 · LANES,) float32: gradients of the basis functions
    splat_ids: np.ndarray  # (LANES,) int32


@kernel()
def projection_backward(first, count, parameters, channels, camera, splats, slots, rows):
    """Gradients of splats [first, first + count), for those that have any; returns how many rows that is.

    Arguments are of the types that have their names; rows: GradientArrays, written from `first` on.
    """
    scratch = Scratch(
        aligned_floats(MAX_SLOT * LANES),
        aligned_floats(16 * LANES),
        aligned_floats(16 * LANES),
        np.zeros(LANES, np.int32),
    )
    total = np.empty(MAX_SLOT, np.float32)
    slot_floats = MOMENTS + channels.colors + channels.depth
    pairs, values, written = splats.pairs, slots.values, slots.written
    done, filled = first, 0
    r = first
    while r < first + count or filled > 0:
        if r < first + count:
            prefetch_parameters(
                splats.gaussian_ids[U(min(r + PREFETCH_DISTANCE, first + count - 1))], parameters, channels
            )
            for j in range(U(slot_floats)):
                total[j] = ZERO
            for slot in range(pairs[U(r), U(0)], pairs[U(r), U(1)]):
                if written[U(slot)]:
                    for j in range(U(slot_floats)):
                        total[j] += values[U(slot) * U(slot_floats) + j]
            pulled = False
            for j in range(U(slot_floats)):
                pulled = pulled or total[j] != ZERO
            if pulled:
                for j in range(U(slot_floats)):
                    scratch.totals[j * U(LANES) + U(filled)] = total[j]
                scratch.splat_ids[filled] = r
                rows.gaussian_ids[U(done + filled)] = splats.gaussian_ids[U(r)]
                filled += 1
            r += 1
            if filled < LANES and r < first + count:
                continue
        if filled == 0:
            break
        for lane in range(filled, LANES):  # an unfinished group repeats its first splat; those rows are unused
            scratch.splat_ids[lane] = scratch.splat_ids[0]
            rows.gaussian_ids[U(done + lane)] = rows.gaussian_ids[U(done)]
        write_rows(done, parameters, channels, camera, splats.values, scratch, rows)
        done += filled
        filled = 0
    return done - first


@kernel(inline=True)
def prefetch_parameters(gaussian_id, parameters, channels):
    """Prefetch the mean and the colours of a Gaussian."""
    means, colors, i = parameters.means, parameters.colors, np.int64(gaussian_id)
    n_bases = (channels.degree + 1) * (channels.degree + 1) if channels.degree >= 0 else 1
    prefetch(means.values, U(i * means.stride + means.first))
    prefetch_columns(colors.values, i, colors.stride, colors.first, n_bases * channels.colors)


@kernel(inline=True)
def write_rows(done, parameters, channels, camera, splats, scratch, rows):
    """Gradient rows done, done + 1, … of the group in `scratch`; splats (n, 16) float32."""
    totals, stride = scratch.totals, rows.values.shape[1]
    footprint = footprint_of(parameters, rows.gaussian_ids, done, camera)
    scales = footprint.scales
    opacity = gather(splats, scratch.splat_ids, 0, FLOATS, OPACITY)
    t0 = load(totals, 0)
    if parameters.raw:
        put_column(rows.values, done, stride, OPACITY_AT, t0 * (ONE - opacity))
    else:
        put_column(rows.values, done, stride, OPACITY_AT, divide(t0, opacity))

    gp, gq, g_scales, g_mean2d = ellipse_gradient(totals, footprint, camera.eps2d)
    put_column(rows.image, done, 3, 0, g_mean2d[0])
    put_column(rows.image, done, 3, 1, g_mean2d[1])
    put_column(rows.image, done, 3, 2, gather(splats, scratch.splat_ids, 0, FLOATS, RADIUS))
    if parameters.raw:
        g_scales = (g_scales[0] * scales[0], g_scales[1] * scales[1], g_scales[2] * scales[2])
    put_three(rows.values, done, SCALES_AT, g_scales)
    dw, dx, dy, dz = quaternion_gradient(
        footprint.quat, footprint.per_length, outer(footprint.ja, footprint.jb, gp, gq)
    )
    put_column(rows.values, done, stride, QUATS_AT, dw)
    put_three(rows.values, done, QUATS_AT + 1, (dx, dy, dz))

    gx, gy, gz = point_gradient(footprint, gp, gq, g_mean2d, camera)
    if channels.depth:
        gz = gz + load(totals, (MOMENTS + channels.colors) * LANES)
    g_mean = (
        gx * camera.x_axis[0] + gy * camera.y_axis[0] + gz * camera.z_axis[0],
        gx * camera.x_axis[1] + gy * camera.y_axis[1] + gz * camera.z_axis[1],
        gx * camera.x_axis[2] + gy * camera.y_axis[2] + gz * camera.z_axis[2],
    )
    if channels.degree < 0:
        used = COLORS_AT + channels.colors
        for c in range(channels.colors):
            put_column(rows.values, done, stride, COLORS_AT + c, load(totals, (MOMENTS + c) * LANES))
    else:
        used = COLORS_AT + (channels.degree + 1) * (channels.degree + 1) * channels.colors
        g_mean = harmonics_gradient(
            g_mean, footprint.mean, done, parameters.colors, channels, camera, splats, scratch, rows
        )
    put_three(rows.values, done, MEANS_AT, g_mean)
    for unused in range(used, stride):
        put_column(rows.values, done, stride, unused, broadcast(ZERO))


@kernel(inline=True)
def put_three(values, row, first_column, vector):
    """Put a vector into columns first_column, + 1, + 2 of rows `row`, row + 1, … of values (n, columns) float32."""
    stride = values.shape[1]
    put_column(values, row, stride, first_column, vector[0])
    put_column(values, row, stride, first_column + 1, vector[1])
    put_column(values, row, stride, first_column + 2, vector[2])


@kernel(inline=True)
def harmonics_gradient(g_mean, mean, done, colors, channels, camera, splats, scratch, rows):
    """Write the gradients of the coefficients; returns that of the mean, with the part of the viewing direction.

    colors: Columns; splats (n, 16) float32.
    """
    stride, n_bases = rows.values.shape[1], (channels.degree + 1) * (channels.degree + 1)
    vx, vy, vz, per_distance = view_direction(mean, camera)
    write_basis(vx, vy, vz, channels.degree, scratch.basis)
    for k in range(n_bases):
        store(scratch.pull, k * LANES, broadcast(ZERO))
    for c in range(channels.colors):
        positive = greater(gather(splats, scratch.splat_ids, 0, FLOATS, CHANNELS + c), broadcast(ZERO))  # else clamped
        g = select(positive, load(scratch.totals, (MOMENTS + c) * LANES), broadcast(ZERO))
        for k in range(n_bases):
            at = k * channels.colors + c
            put_column(rows.values, done, stride, COLORS_AT + at, load(scratch.basis, k * LANES) * g)
            coefficient = column(colors, rows.gaussian_ids, done, at)
            store(scratch.pull, k * LANES, load(scratch.pull, k * LANES) + coefficient * g)
    gx, gy, gz = g_mean
    if channels.degree > 0:
        gdx, gdy, gdz = direction_gradient(vx, vy, vz, channels.degree, scratch.pull)
        dot = gdx * vx + gdy * vy + gdz * vz
        gx = gx + (gdx - dot * vx) * per_distance
        gy = gy + (gdy - dot * vy) * per_distance
        gz = gz + (gdz - dot * vz) * per_distance
    return gx, gy, gz

"""From Gaussians to tile lists: project, cull, pack, and list for every 16×16 tile its Gaussians from near to far.

Each kept Gaussian becomes one record of 16 floats (a cache line): u, v, then A, B, C and log2(opacity), so that
log2(alpha) = log2(opacity) + A dx² + B dx dy + C dy²; the opacity; and the channels. The box in which alpha ≥ 1/255 is
kept beside it. No list of pairs is sorted: N depths are, and the lists are filled in that order.
"""

from __future__ import annotations

import math

import numpy as np
from numba import int64

from tdgbench.splats.cpu.harmonics import view_direction, write_basis
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.projection import (
    along_axes,
    camera_point,
    clamped_ray,
    covariance_2d,
    jacobian_rows,
    rotation,
    scaled,
    screen_radius,
)
from tdgbench.splats.cpu.simd import float_bits

F, U = np.float32, np.uint64
TILE = 16
U_, V_, A_, B_, C_, LOG2_OPACITY, OPACITY, CHANNELS = range(8)
RECORD = 16
ZERO, HALF, ONE, TWO, FOUR = F(0), F(0.5), F(1), F(2), F(4)
LOG2_E = F(math.log2(math.e))
MIN_ALPHA = F(1 / 255)
LOG2_MIN_ALPHA = F(math.log2(1 / 255))
SLACK = F(0.01)  # px by which boxes are widened against rounding; the blend decides on alpha itself
FAR_AWAY = F(1e9)  # px: beyond it, whole numbers of pixels make no sense


@kernel(inline=True)
def write_color(records, i, colors, degree, means, camera, basis):
    """The channels of a Gaussian: as given (degree −1) or from its spherical harmonics."""
    channels = colors.shape[2]
    if degree < 0:
        for c in range(U(channels)):
            records[i, U(CHANNELS) + c] = colors[i, U(0), c]
    else:
        x, y, z, _ = view_direction(means[i, 0], means[i, 1], means[i, 2], camera)
        write_basis(x, y, z, degree, basis)
        for c in range(U(channels)):
            total = HALF
            for k in range(U((degree + 1) * (degree + 1))):
                total += basis[k] * colors[i, k, c]
            records[i, U(CHANNELS) + c] = max(total, ZERO)


@kernel()
def project_and_list(
    start, stop, means, scales, quats, opacities, colors, degree, camera, depth_channel,
    records, boxes, offsets, depth_keys, kept, radii, means2d, tile_of_pair, pairs_per_tile, counts,
):  # fmt: skip
    """Project Gaussians [start, stop); list the tiles of each that can be seen. counts = [kept, pairs].

    Pairs beyond the room in `tile_of_pair` are counted but not written: the caller makes room and calls again.
    """
    width, height = camera[22], camera[23]
    tiles_x = (int64(width) + TILE - 1) // TILE
    room = tile_of_pair.shape[0]
    channels = colors.shape[2]
    basis = np.empty(16, np.float32)
    n_kept = start
    n_pairs = 0
    for i_ in range(start, stop):
        i = U(i_)
        offsets[i] = n_pairs
        radii[i] = 0
        x, y, z = camera_point(i, means, camera)
        if not (z > camera[19] and z < camera[20]):
            continue
        rz = ONE / z
        tx, ty = clamped_ray(x, y, rz, camera)
        r0, r1, r2, _ = rotation(i, quats)
        ja, jb = jacobian_rows(tx, ty, rz, camera)
        p = scaled(along_axes(ja, r0, r1, r2), i, scales)
        q = scaled(along_axes(jb, r0, r1, r2), i, scales)
        a, b, c, det = covariance_2d(p, q, camera[21])
        if not (det > ZERO and det < F(np.inf)):
            continue
        u = camera[12] * x * rz + camera[14]
        v = camera[13] * y * rz + camera[15]
        means2d[i, 0] = u
        means2d[i, 1] = v
        radii[i] = np.int32(min(screen_radius(a, c, det, u, v, camera), FAR_AWAY))
        opacity = opacities[i]
        if not (opacity >= MIN_ALPHA):
            continue
        log2_opacity = F(math.log2(opacity))
        cut = log2_opacity - LOG2_MIN_ALPHA
        hw = math.sqrt(TWO * cut / LOG2_E * a)
        hh = math.sqrt(TWO * cut / LOG2_E * c)
        left = max(u - hw - HALF - SLACK, ZERO)
        right = min(u + hw - HALF + SLACK, width - ONE)
        top = max(v - hh - HALF - SLACK, ZERO)
        bottom = min(v + hh - HALF + SLACK, height - ONE)
        if not (right >= left and bottom >= top):
            continue
        x0, x1 = int64(math.ceil(left)), int64(right)
        y0, y1 = int64(math.ceil(top)), int64(bottom)
        if x1 < x0 or y1 < y0:
            continue
        A = -HALF * LOG2_E * c / det
        B = LOG2_E * b / det
        C = -HALF * LOG2_E * a / det
        records[i, U_] = u
        records[i, V_] = v
        records[i, A_] = A
        records[i, B_] = B
        records[i, C_] = C
        records[i, LOG2_OPACITY] = log2_opacity
        records[i, OPACITY] = opacity
        write_color(records, i, colors, degree, means, camera, basis)
        if depth_channel:
            records[i, U(CHANNELS + channels)] = z
        boxes[i, 0] = x0
        boxes[i, 1] = x1
        boxes[i, 2] = y0
        boxes[i, 3] = y1
        before = n_pairs
        # Where the box spans 2×2 tiles or more it has corners that the ellipse does not reach: cut each row of tiles
        # to the ellipse's own extent there. Roots of A dx² + B dy dx + C dy² = −cut; B² − 4AC = −log2(e)²/det.
        has_corners = (x1 >> 4) > (x0 >> 4) and (y1 >> 4) > (y0 >> 4)
        discriminant = -LOG2_E * LOG2_E / det
        y_of_right_end = b / a * hw
        for tile_y in range(y0 >> 4, (y1 >> 4) + 1):
            first, last = x0, x1
            if has_corners:
                upper = max(F(tile_y * TILE) + HALF - v, -hh)
                lower = min(F(tile_y * TILE + TILE - 1) + HALF - v, hh)
                root_u = math.sqrt(max(discriminant * upper * upper - FOUR * A * cut, ZERO))
                root_l = math.sqrt(max(discriminant * lower * lower - FOUR * A * cut, ZERO))
                if y_of_right_end >= upper and y_of_right_end <= lower:
                    reach_right = hw
                else:
                    reach_right = max((-B * upper - root_u) * HALF / A, (-B * lower - root_l) * HALF / A)
                if -y_of_right_end >= upper and -y_of_right_end <= lower:
                    reach_left = -hw
                else:
                    reach_left = min((-B * upper + root_u) * HALF / A, (-B * lower + root_l) * HALF / A)
                begin = max(u + reach_left - HALF - SLACK, F(x0))
                end = min(u + reach_right - HALF + SLACK, F(x1))
                if not (end >= begin):
                    continue
                first, last = int64(math.ceil(begin)), int64(end)
                if last < first:
                    continue
            for tile_x in range(first >> 4, (last >> 4) + 1):
                tile = tile_y * tiles_x + tile_x
                pairs_per_tile[U(tile)] += 1
                if n_pairs < room:
                    tile_of_pair[U(n_pairs)] = tile
                n_pairs += 1
        if n_pairs > before:
            depth_keys[U(n_kept)] = float_bits(z)
            kept[U(n_kept)] = i_
            n_kept += 1
    counts[0] = n_kept - start
    counts[1] = n_pairs


@kernel()
def gather(start, stop, n_kept, n_pairs, kept_base, pair_base, offsets, depth_keys, kept, tile_of_pair,
           all_keys, all_kept, all_tiles):  # fmt: skip
    """Move one chunk's lists behind those of the chunks before it."""
    all_keys[kept_base : kept_base + n_kept] = depth_keys[start : start + n_kept]
    all_kept[kept_base : kept_base + n_kept] = kept[start : start + n_kept]
    all_tiles[pair_base : pair_base + n_pairs] = tile_of_pair[:n_pairs]
    for i in range(start, stop):
        offsets[U(i)] += pair_base


@kernel()
def sort_by_depth(keys, values, spare_keys, spare_values, count):
    """Stable radix sort of positive float bits, three passes of 11 bits; the result ends in the spare arrays."""
    histogram = np.empty(2048, np.int64)
    for digit in range(3):
        shift = 11 * digit
        histogram[:] = 0
        for i in range(U(count)):
            histogram[(keys[i] >> shift) & 2047] += 1
        total = 0
        for b in range(U(2048)):
            size = histogram[b]
            histogram[b] = total
            total += size
        for i in range(U(count)):
            b = U((keys[i] >> shift) & 2047)
            place = U(histogram[b])
            histogram[b] = int64(place) + 1
            spare_keys[place] = keys[i]
            spare_values[place] = values[i]
        keys, spare_keys = spare_keys, keys
        values, spare_values = spare_values, values


@kernel()
def fill_lists(first_tile, last_tile, count, cursor, order, offsets, tile_of_pair, gaussian_of, slot_of):
    """Fill the lists of tiles [first_tile, last_tile) in depth order; slot_of names the pair's own gradient slot."""
    for k in range(U(count)):
        i = U(order[k])
        for pair in range(offsets[i], offsets[i + U(1)]):
            tile = tile_of_pair[U(pair)]
            if tile < first_tile or tile >= last_tile:
                continue
            place = U(cursor[U(tile)])
            cursor[U(tile)] = int64(place) + 1
            gaussian_of[place] = i
            slot_of[place] = pair

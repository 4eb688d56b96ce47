"""Projection of the Gaussians to the image (EWA), their colours, and pairs with the tiles that they may touch.

Pairs are sorted by tile and depth: each tile has its Gaussians from near to far.
"""

import warp as wp

from tdgbench.splats.harmonics import C0, C1, C2, C3
from tdgbench.splats.warp.arrays import TILE, Splats2D, TilePairs, WarpSource, WarpView

vec16 = wp.types.vector(length=16, dtype=float)
a0 = wp.constant(C0)
a1 = wp.constant(C1)
b0, b1, b2, b3, b4 = (wp.constant(c) for c in C2)
c0, c1, c2, c3, c4, c5, c6 = (wp.constant(c) for c in C3)

wp.set_module_options({"enable_backward": False})


@wp.func
def rotation_of(n: wp.vec4):
    """Return the rotation of a unit quaternion wxyz; the identity for zeros."""
    w, x, y, z = n[0], n[1], n[2], n[3]
    return wp.mat33(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    )  # fmt: skip


@wp.func
def slope(ratio: float, size: int, focal: float, principal: float):
    """Return x / z (or y / z) of a centre, kept within 15 % of the image around it, as in 3DGS."""
    margin = 0.15 * float(size) / focal
    return wp.clamp(ratio, -principal / focal - margin, (float(size) - principal) / focal + margin)


@wp.func
def to_world(v: WarpView, p: wp.vec3, axis: int):
    """Return the gradient of an image coordinate (0: x, 1: y) by the position p, in world axes, px per unit."""
    size = wp.where(axis == 0, v.width, v.height)
    scale = v.focal[axis] / p[2]
    row = wp.vec3(0.0, 0.0, -scale * slope(p[axis] / p[2], size, v.focal[axis], v.principal[axis]))
    row[axis] = scale
    return wp.transpose(v.rotation) * row


@wp.func
def basis(d: wp.vec3):
    """Return the 16 spherical harmonics at a unit direction, in the order and signs of `splats.harmonics`."""
    x, y, z = d[0], d[1], d[2]
    xx, yy, zz = x * x, y * y, z * z
    return vec16(
        a0, -a1 * y, a1 * z, -a1 * x,
        b0 * x * y, b1 * y * z, b2 * (2.0 * zz - xx - yy), b3 * x * z, b4 * (xx - yy),
        c0 * y * (3.0 * xx - yy), c1 * x * y * z, c2 * y * (4.0 * zz - xx - yy),
        c3 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy), c4 * x * (4.0 * zz - xx - yy), c5 * z * (xx - yy),
        c6 * x * (xx - 3.0 * yy),
    )  # fmt: skip


@wp.func
def basis_gradient(d: wp.vec3, w: vec16):
    """Return the gradient of Σ_k w_k basis_k by the direction."""
    x, y, z = d[0], d[1], d[2]
    xx, yy, zz = x * x, y * y, z * z
    by_x = vec16(
        0.0, 0.0, 0.0, -a1, b0 * y, 0.0, -2.0 * b2 * x, b3 * z, 2.0 * b4 * x,
        6.0 * c0 * x * y, c1 * y * z, -2.0 * c2 * x * y, -6.0 * c3 * x * z, c4 * (4.0 * zz - 3.0 * xx - yy),
        2.0 * c5 * x * z, 3.0 * c6 * (xx - yy),
    )  # fmt: skip
    by_y = vec16(
        0.0, -a1, 0.0, 0.0, b0 * x, b1 * z, -2.0 * b2 * y, 0.0, -2.0 * b4 * y,
        3.0 * c0 * (xx - yy), c1 * x * z, c2 * (4.0 * zz - xx - 3.0 * yy), -6.0 * c3 * y * z, -2.0 * c4 * x * y,
        -2.0 * c5 * y * z, -6.0 * c6 * x * y,
    )  # fmt: skip
    by_z = vec16(
        0.0, 0.0, a1, 0.0, 0.0, b1 * y, 4.0 * b2 * z, b3 * x, 0.0,
        0.0, c1 * x * y, 8.0 * c2 * y * z, c3 * (6.0 * zz - 3.0 * xx - 3.0 * yy), 8.0 * c4 * x * z,
        c5 * (xx - yy), 0.0,
    )  # fmt: skip
    return wp.vec3(wp.dot(by_x, w), wp.dot(by_y, w), wp.dot(by_z, w))


@wp.func
def is_broken(g: int, source: WarpSource, bases: int):
    """Return whether a Gaussian has a NaN."""
    total = source.opacities[g]
    total += wp.dot(source.means[g], wp.vec3(1.0)) + wp.dot(source.scales[g], wp.vec3(1.0))
    total += wp.dot(source.quats[g], wp.vec4(1.0))
    for k in range(wp.max(bases, 1)):
        for c in range(source.colors.shape[2]):
            total += source.colors[g, k, c]
    return wp.isnan(total)


@wp.func
def covered(low: float, high: float, tiles: int):
    """Return the first of the tiles between two image coordinates, and the one after the last."""
    first = int(wp.floor(wp.clamp(low / float(TILE), 0.0, float(tiles))))
    last = int(wp.ceil(wp.clamp(high / float(TILE), 0.0, float(tiles))))
    return first, last


@wp.func
def radius(center: wp.vec2, a: float, b: float, c: float, v: WarpView):
    """Return 3DGS's radius in px, 3 σ rounded up, of a covariance (a, b, c); 0 if the square misses the tiles."""
    half = 0.5 * (a - c)
    r = wp.ceil(3.0 * wp.sqrt(0.5 * (a + c) + wp.sqrt(wp.max(half * half + b * b, 0.1))))
    x, y = center[0] - 0.5, center[1] - 0.5
    seen = x + r >= 1.0 and y + r >= 1.0 and x - r < float(v.tiles_x * TILE) and y - r < float(v.tiles_y * TILE)
    return wp.where(seen, int(wp.min(r, 1.0e9)), 0)


@wp.func
def write_features(g: int, source: WarpSource, v: WarpView, depth: float, features: wp.array2d(dtype=float)):
    """Write the colours of a Gaussian, and its depth if `features` has a column for it."""
    channels = source.colors.shape[2]
    b = basis(wp.normalize(source.means[g] - v.centre))
    for c in range(channels):
        if v.bases == 0:
            features[g, c] = source.colors[g, 0, c]
        else:
            color = float(0.5)
            for k in range(v.bases):
                color += b[k] * source.colors[g, k, c]
            features[g, c] = wp.max(color, 0.0)
    if features.shape[1] > channels:
        features[g, channels] = depth


@wp.kernel
def project(source: WarpSource, v: WarpView, out: Splats2D):
    """Project each Gaussian; `out.ends` gets its number of tiles. All of `out` is zero before."""
    g = wp.tid()
    if is_broken(g, source, v.bases):
        out.broken[0] = 1
    p = v.rotation * source.means[g] + v.translation
    out.depths[g] = p[2]
    if not (p[2] > v.near and p[2] < v.far):
        return
    turn = wp.transpose(rotation_of(wp.normalize(source.quats[g])))
    x = wp.cw_mul(turn * to_world(v, p, 0), source.scales[g])
    y = wp.cw_mul(turn * to_world(v, p, 1), source.scales[g])
    a, b, c = wp.dot(x, x) + v.eps2d, wp.dot(x, y), wp.dot(y, y) + v.eps2d
    cross = wp.cross(x, y)  # its square is the determinant without eps2d, and loses no digits
    det = wp.dot(cross, cross) + v.eps2d * (a + c - v.eps2d)
    center = wp.vec2(v.focal[0] * p[0] / p[2] + v.principal[0], v.focal[1] * p[1] / p[2] + v.principal[1])
    out.means2d[g] = center
    out.radii[g] = radius(center, a, b, c, v)
    opacity = source.opacities[g]
    if not opacity >= v.min_alpha:
        return
    reach = 1.0001 * wp.sqrt(2.0 * wp.log(opacity / v.min_alpha))  # in σ; beyond it, alpha is below min_alpha
    half_x, half_y = reach * wp.sqrt(a) + 0.01, reach * wp.sqrt(c) + 0.01
    x0, x1 = covered(center[0] - half_x, center[0] + half_x, v.tiles_x)
    y0, y1 = covered(center[1] - half_y, center[1] + half_y, v.tiles_y)
    if x1 > x0 and y1 > y0:
        out.rects[g] = wp.vec4i(x0, y0, x1, y1)
        out.ends[g] = (x1 - x0) * (y1 - y0)
        out.shapes[g] = wp.vec3(c / det, b / c, 1.0 / c)
        write_features(g, source, v, p[2], out.features)


@wp.kernel
def list_pairs(projected: Splats2D, v: WarpView, keys: wp.array(dtype=wp.int64), pairs: TilePairs):
    """Write the pairs of each Gaussian, with tile and depth as the sort key."""
    g = wp.tid()
    rect = projected.rects[g]
    slot = int(0)
    if g > 0:
        slot = projected.ends[g - 1]
    depth = wp.int64(wp.cast(projected.depths[g], int))  # bits of positive floats have the order of the floats
    for y in range(rect[1], rect[3]):
        for x in range(rect[0], rect[2]):
            keys[slot] = (wp.int64(y * v.tiles_x + x) << wp.int64(32)) | depth
            pairs.slots[slot] = slot
            pairs.owners[slot] = g
            slot += 1


@wp.kernel
def find_starts(keys: wp.array(dtype=wp.int64), count: int, starts: wp.array(dtype=int)):
    """Find the first of the sorted pairs of each tile, by bisection."""
    tile = wp.tid()
    low, high = int(0), int(count)
    while low < high:
        middle = (low + high) // 2
        if int(keys[middle] >> wp.int64(32)) < tile:
            low = middle + 1
        else:
            high = middle
    starts[tile] = low

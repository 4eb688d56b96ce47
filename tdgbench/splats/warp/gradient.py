"""From the gradients of pairs to those of Gaussians: sums in a fixed order, then the chain rule of `project`."""

import warp as wp

from tdgbench.splats.warp.arrays import Splats2D, WarpSource, WarpView
from tdgbench.splats.warp.blend import GEOMETRY
from tdgbench.splats.warp.projection import basis, basis_gradient, rotation_of, slope, to_world, vec16

wp.set_module_options({"enable_backward": False})


@wp.kernel
def add_pairs(rows: wp.array2d(dtype=float), ends: wp.array(dtype=int), sums: wp.array2d(dtype=float)):
    """Add up the rows (pairs, columns) of each Gaussian, in the order of its tiles; a thread per column."""
    g, column = wp.tid()
    first, total = int(0), float(0.0)
    if g > 0:
        first = ends[g - 1]
    for slot in range(first, ends[g]):
        total += rows[slot, column]
    sums[g, column] = total


@wp.func
def by_center(v: WarpView, p: wp.vec3, axis: int, by_axis: wp.vec3, by_mean: float):
    """Return the gradient by p of what depends on an image coordinate (0: x, 1: y).

    by_axis: by `to_world`, in camera axes; by_mean: by the coordinate.
    """
    iz, focal = 1.0 / p[2], v.focal[axis]
    ratio = p[axis] * iz
    kept = slope(ratio, wp.where(axis == 0, v.width, v.height), focal, v.principal[axis])
    by_ratio = focal * by_mean
    if kept == ratio:
        by_ratio -= focal * iz * by_axis[2]
    by_iz = focal * (by_axis[axis] - kept * by_axis[2])
    result = wp.vec3(0.0, 0.0, -iz * (by_ratio * ratio + iz * by_iz))
    result[axis] = by_ratio * iz
    return result


@wp.func
def by_quaternion(q: wp.vec4, m: wp.mat33):
    """Return the gradient by a quaternion of any length of what has the gradient m by its rotation."""
    length = wp.length(q)
    if length == 0.0:
        return wp.vec4()
    n = q / length
    w, x, y, z = n[0], n[1], n[2], n[3]
    by_n = 2.0 * wp.vec4(
        x * (m[2, 1] - m[1, 2]) + y * (m[0, 2] - m[2, 0]) + z * (m[1, 0] - m[0, 1]),
        w * (m[2, 1] - m[1, 2]) + y * (m[0, 1] + m[1, 0]) + z * (m[0, 2] + m[2, 0]) - 2.0 * x * (m[1, 1] + m[2, 2]),
        w * (m[0, 2] - m[2, 0]) + x * (m[0, 1] + m[1, 0]) + z * (m[1, 2] + m[2, 1]) - 2.0 * y * (m[0, 0] + m[2, 2]),
        w * (m[1, 0] - m[0, 1]) + x * (m[0, 2] + m[2, 0]) + y * (m[1, 2] + m[2, 1]) - 2.0 * z * (m[0, 0] + m[1, 1]),
    )  # fmt: skip
    return (by_n - n * wp.dot(n, by_n)) / length


@wp.func
def by_colors(
    g: int, source: WarpSource, v: WarpView, projected: Splats2D, sums: wp.array2d(dtype=float), out: WarpSource
):
    """Write the gradient of the colours or harmonics; returns that by the mean, through the direction of view."""
    channels = source.colors.shape[2]
    toward = source.means[g] - v.centre
    d = wp.normalize(toward)
    b = basis(d)
    weights = vec16()
    for c in range(channels):
        by_color = sums[g, GEOMETRY + c]
        if v.bases == 0:
            out.colors[g, 0, c] = by_color
        elif projected.features[g, c] > 0.0:
            for k in range(v.bases):
                out.colors[g, k, c] = b[k] * by_color
                weights[k] += source.colors[g, k, c] * by_color
    by_d = basis_gradient(d, weights)
    return (by_d - d * wp.dot(d, by_d)) / wp.max(wp.length(toward), 1.0e-12)


@wp.kernel
def project_backward(
    source: WarpSource, v: WarpView, projected: Splats2D, sums: wp.array2d(dtype=float), out: WarpSource
):
    """Write the gradients of each Gaussian with pairs, by those of `Splats2D` in `sums`. `out` is zero before."""
    g = wp.tid()
    if projected.shapes[g][0] == 0.0:
        return
    q, s = source.quats[g], source.scales[g]
    p = v.rotation * source.means[g] + v.translation
    turn = rotation_of(wp.normalize(q))
    world_x, world_y = to_world(v, p, 0), to_world(v, p, 1)
    local_x, local_y = wp.transpose(turn) * world_x, wp.transpose(turn) * world_y
    x, y = wp.cw_mul(local_x, s), wp.cw_mul(local_y, s)
    shape = projected.shapes[g]  # q = c / det, k = b / c, v = 1 / c of the covariance (a, b, c)
    k = shape[1]
    by_a = -shape[0] * shape[0] * sums[g, 2]
    by_b = -2.0 * k * by_a + shape[2] * sums[g, 3]
    by_c = k * k * by_a - k * shape[2] * sums[g, 3] - shape[2] * shape[2] * sums[g, 4]
    by_x, by_y = 2.0 * by_a * x + by_b * y, 2.0 * by_c * y + by_b * x
    out.scales[g] = wp.cw_mul(by_x, local_x) + wp.cw_mul(by_y, local_y)
    by_x, by_y = wp.cw_mul(by_x, s), wp.cw_mul(by_y, s)
    out.quats[g] = by_quaternion(q, wp.outer(world_x, by_x) + wp.outer(world_y, by_y))
    by_p = by_center(v, p, 0, v.rotation * (turn * by_x), sums[g, 0])
    by_p += by_center(v, p, 1, v.rotation * (turn * by_y), sums[g, 1])
    channels = source.colors.shape[2]
    if projected.features.shape[1] > channels:
        by_p += wp.vec3(0.0, 0.0, sums[g, GEOMETRY + channels])
    out.opacities[g] = sums[g, 5]
    out.means[g] = wp.transpose(v.rotation) * by_p + by_colors(g, source, v, projected, sums, out)

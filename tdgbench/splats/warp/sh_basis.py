"""Real spherical harmonics up to degree 3 and their derivatives, in the order and signs of `splats.harmonics`."""

import warp as wp

from tdgbench.splats.harmonics import C0, C1, C2, C3

vec16 = wp.types.vector(length=16, dtype=float)
a0 = wp.constant(C0)
a1 = wp.constant(C1)
b0, b1, b2, b3, b4 = (wp.constant(c) for c in C2)
c0, c1, c2, c3, c4, c5, c6 = (wp.constant(c) for c in C3)


@wp.func
def basis(d: wp.vec3):
    """Return the 16 basis functions at a unit direction."""
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

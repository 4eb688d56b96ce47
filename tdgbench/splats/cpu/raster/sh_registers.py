"""Spherical harmonics and their gradient, LANES directions at a time, as in `tdgbench.splats.harmonics`.

Directions and means are tuples of registers; buffers hold 16 registers, (16 · LANES,) float32.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats import harmonics
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.projection import from_camera
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.registers import LANES, broadcast, divide, square_root

F = np.float32
C0, C1 = F(harmonics.C0), F(harmonics.C1)
C20, C21, C22, C23, C24 = (F(c) for c in harmonics.C2)
C30, C31, C32, C33, C34, C35, C36 = (F(c) for c in harmonics.C3)
_1, _2, _3, _4, _6, _8 = F(1), F(2), F(3), F(4), F(6), F(8)


@kernel(inline=True)
def view_direction(mean, camera):
    """Unit vectors from the camera centre to the Gaussians, and the inverse of the distance."""
    x, y, z = from_camera(mean, camera)
    inverse = divide(_1, square_root(x * x + y * y + z * z))
    return x * inverse, y * inverse, z * inverse, inverse


@kernel(inline=True)
def write_basis(x, y, z, degree, b):
    """Write basis function k at the unit directions (x, y, z) to register k of b, for k < (degree + 1)²."""
    store(b, 0, broadcast(C0))
    if degree >= 1:
        store(b, LANES, y * -C1)
        store(b, 2 * LANES, C1 * z)
        store(b, 3 * LANES, x * -C1)
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        store(b, 4 * LANES, C20 * x * y)
        store(b, 5 * LANES, C21 * y * z)
        store(b, 6 * LANES, C22 * (_2 * zz - xx - yy))
        store(b, 7 * LANES, C23 * x * z)
        store(b, 8 * LANES, C24 * (xx - yy))
        if degree >= 3:
            store(b, 9 * LANES, C30 * y * (_3 * xx - yy))
            store(b, 10 * LANES, C31 * x * y * z)
            store(b, 11 * LANES, C32 * y * (_4 * zz - xx - yy))
            store(b, 12 * LANES, C33 * z * (_2 * zz - _3 * xx - _3 * yy))
            store(b, 13 * LANES, C34 * x * (_4 * zz - xx - yy))
            store(b, 14 * LANES, C35 * z * (xx - yy))
            store(b, 15 * LANES, C36 * x * (xx - _3 * yy))


@kernel(inline=True)
def direction_gradient(x, y, z, degree, s):
    """d(Σ_k s_k basis_k)/d(x, y, z), where s_k is register k of s; degree ≥ 1."""
    s1, s2, s3 = load(s, LANES), load(s, 2 * LANES), load(s, 3 * LANES)
    gx = s3 * -C1
    gy = s1 * -C1
    gz = C1 * s2
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        s4, s5, s6 = load(s, 4 * LANES), load(s, 5 * LANES), load(s, 6 * LANES)
        s7, s8 = load(s, 7 * LANES), load(s, 8 * LANES)
        gx += C20 * y * s4 - _2 * C22 * x * s6 + C23 * z * s7 + _2 * C24 * x * s8
        gy += C20 * x * s4 + C21 * z * s5 - _2 * C22 * y * s6 - _2 * C24 * y * s8
        gz += C21 * y * s5 + _4 * C22 * z * s6 + C23 * x * s7
        if degree >= 3:
            s9, s10, s11 = load(s, 9 * LANES), load(s, 10 * LANES), load(s, 11 * LANES)
            s12, s13, s14 = load(s, 12 * LANES), load(s, 13 * LANES), load(s, 14 * LANES)
            s15 = load(s, 15 * LANES)
            gx += (
                _6 * C30 * x * y * s9
                + C31 * y * z * s10
                - _2 * C32 * x * y * s11
                - _6 * C33 * x * z * s12
                + C34 * (_4 * zz - _3 * xx - yy) * s13
                + _2 * C35 * x * z * s14
                + _3 * C36 * (xx - yy) * s15
            )
            gy += (
                _3 * C30 * (xx - yy) * s9
                + C31 * x * z * s10
                + C32 * (_4 * zz - xx - _3 * yy) * s11
                - _6 * C33 * y * z * s12
                - _2 * C34 * x * y * s13
                - _2 * C35 * y * z * s14
                - _6 * C36 * x * y * s15
            )
            gz += (
                C31 * x * y * s10
                + _8 * C32 * y * z * s11
                + C33 * (_6 * zz - _3 * xx - _3 * yy) * s12
                + _8 * C34 * x * z * s13
                + C35 * (xx - yy) * s14
            )
    return gx, gy, gz

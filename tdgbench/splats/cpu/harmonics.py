"""Spherical-harmonics colours of one Gaussian and their gradients (the same basis as `tdgbench.splats.harmonics`)."""

from __future__ import annotations

import math

import numpy as np

from tdgbench.splats import harmonics
from tdgbench.splats.cpu.jit import kernel

F = np.float32
C0, C1 = F(harmonics.C0), F(harmonics.C1)
C20, C21, C22, C23, C24 = (F(c) for c in harmonics.C2)
C30, C31, C32, C33, C34, C35, C36 = (F(c) for c in harmonics.C3)
_1, _2, _3, _4, _6, _8 = F(1), F(2), F(3), F(4), F(6), F(8)


@kernel(inline=True)
def view_direction(mx, my, mz, camera):
    """Unit vector from the camera centre to the Gaussian, and the inverse of the distance."""
    x = mx - camera[16]
    y = my - camera[17]
    z = mz - camera[18]
    inverse = _1 / math.sqrt(x * x + y * y + z * z)
    return x * inverse, y * inverse, z * inverse, inverse


@kernel()
def write_basis(x, y, z, degree, b):
    """b[k] = basis function k at the unit direction (x, y, z), for k < (degree + 1)²."""
    b[0] = C0
    if degree >= 1:
        b[1] = -C1 * y
        b[2] = C1 * z
        b[3] = -C1 * x
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        b[4] = C20 * x * y
        b[5] = C21 * y * z
        b[6] = C22 * (_2 * zz - xx - yy)
        b[7] = C23 * x * z
        b[8] = C24 * (xx - yy)
        if degree >= 3:
            b[9] = C30 * y * (_3 * xx - yy)
            b[10] = C31 * x * y * z
            b[11] = C32 * y * (_4 * zz - xx - yy)
            b[12] = C33 * z * (_2 * zz - _3 * xx - _3 * yy)
            b[13] = C34 * x * (_4 * zz - xx - yy)
            b[14] = C35 * z * (xx - yy)
            b[15] = C36 * x * (xx - _3 * yy)


@kernel()
def direction_gradient(x, y, z, degree, s):
    """d(Σ_k s_k basis_k)/d(x, y, z)."""
    gx = -C1 * s[3]
    gy = -C1 * s[1]
    gz = C1 * s[2]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        gx += C20 * y * s[4] - _2 * C22 * x * s[6] + C23 * z * s[7] + _2 * C24 * x * s[8]
        gy += C20 * x * s[4] + C21 * z * s[5] - _2 * C22 * y * s[6] - _2 * C24 * y * s[8]
        gz += C21 * y * s[5] + _4 * C22 * z * s[6] + C23 * x * s[7]
        if degree >= 3:
            gx += (
                _6 * C30 * x * y * s[9]
                + C31 * y * z * s[10]
                - _2 * C32 * x * y * s[11]
                - _6 * C33 * x * z * s[12]
                + C34 * (_4 * zz - _3 * xx - yy) * s[13]
                + _2 * C35 * x * z * s[14]
                + _3 * C36 * (xx - yy) * s[15]
            )
            gy += (
                _3 * C30 * (xx - yy) * s[9]
                + C31 * x * z * s[10]
                + C32 * (_4 * zz - xx - _3 * yy) * s[11]
                - _6 * C33 * y * z * s[12]
                - _2 * C34 * x * y * s[13]
                - _2 * C35 * y * z * s[14]
                - _6 * C36 * x * y * s[15]
            )
            gz += (
                C31 * x * y * s[10]
                + _8 * C32 * y * z * s[11]
                + C33 * (_6 * zz - _3 * xx - _3 * yy) * s[12]
                + _8 * C34 * x * z * s[13]
                + C35 * (xx - yy) * s[14]
            )
    return gx, gy, gz

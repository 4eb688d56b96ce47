"""Real spherical harmonics up to degree 3, in 3DGS's sign convention: its PLY files mean the same here."""

from __future__ import annotations

import torch
from torch import Tensor

MAX_DEGREE = 3
C0 = 0.28209479177387814
C1 = 0.4886025119029199
C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def num_bases(degree: int) -> int:
    """Return the number of coefficients per channel at a degree: (degree + 1)².

    >>> [num_bases(degree) for degree in range(4)]
    [1, 4, 9, 16]
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise ValueError(f"sh_degree is {degree}; it must be 0 to {MAX_DEGREE}")
    return (degree + 1) ** 2


def sh_basis(directions: Tensor, degree: int) -> Tensor:
    """Return basis functions (…, (degree + 1)²) at unit directions (…, 3).

    >>> sh_basis(torch.tensor([0.0, 0.0, 1.0]), 1)
    tensor([0.2821, -0.0000, 0.4886, -0.0000])
    """
    x, y, z = directions.unbind(-1)
    values = [torch.full_like(x, C0)]
    if degree >= 1:
        values += [-C1 * y, C1 * z, -C1 * x]
    if degree >= 2:
        xx, yy, zz = x * x, y * y, z * z
        values += [C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy), C2[3] * x * z, C2[4] * (xx - yy)]
    if degree >= 3:
        values += [
            C3[0] * y * (3 * xx - yy),
            C3[1] * x * y * z,
            C3[2] * y * (4 * zz - xx - yy),
            C3[3] * z * (2 * zz - 3 * xx - 3 * yy),
            C3[4] * x * (4 * zz - xx - yy),
            C3[5] * z * (xx - yy),
            C3[6] * x * (xx - 3 * yy),
        ]
    return torch.stack(values, dim=-1)


def colors_from_sh(sh: Tensor, directions: Tensor, degree: int) -> Tensor:
    """Return view-dependent colours (N, C) of coefficients (N, K, C): max(0, 1/2 + Σ_k basis_k · sh_k), as in 3DGS."""
    weights = sh_basis(directions, degree)
    return ((weights.unsqueeze(-1) * sh[:, : num_bases(degree)]).sum(dim=1) + 0.5).clamp_min(0.0)


def sh_from_color(color: Tensor) -> Tensor:
    """Return the degree-0 coefficient of a colour in [0, 1], any shape.

    >>> sh_from_color(torch.tensor([0.0, 0.5, 1.0]))
    tensor([-1.7725,  0.0000,  1.7725])
    """
    return (color - 0.5) / C0

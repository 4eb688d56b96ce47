"""Volume rendering (Max 1995; Mildenhall et al. 2020, eq. 3): weights, depth, and any number of channels."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def weights_of(densities: Tensor, lengths: Tensor) -> Tensor:
    """Return the weights (R, S) of samples, w_i = T_i (1 − exp(−σ_i δ_i)), T_i = exp(−Σ_{j<i} σ_j δ_j).

    densities: (R, S), per unit of length. lengths: δ (R, S) of the samples' intervals.
    """
    optical = densities * lengths
    before = functional.pad(torch.cumsum(optical, dim=1)[:, :-1], (1, 0))  # a difference is NaN behind infinity
    return torch.exp(-before) * -torch.expm1(-optical)


def transmittance_of(weights: Tensor) -> Tensor:
    """Return the share of the light (R,) that comes from behind all samples: 1 − Σ w."""
    return 1 - weights.sum(dim=1)


def composited(weights: Tensor, values: Tensor, behind: Tensor | None = None) -> Tensor:
    """Return Σ w v (R, C) of values (R, S, C), over the colour behind the samples, (C,) or (R, C); None: black.

    Of depths it is the accumulated depth, which is the expected one after a division by Σ w.
    """
    image = torch.einsum("rs,rsc->rc", weights, values)
    return image if behind is None else image + transmittance_of(weights)[:, None] * behind

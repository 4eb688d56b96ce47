"""The random clouds that the benchmarks render."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Cloud:
    """Gaussians before a camera that looks along z; colours (N, 3) in [0, 1]."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    viewmat: Tensor
    K: Tensor
    width: int
    height: int


def random_cloud(count: int, width: int, height: int, seed: int = 0) -> Cloud:
    """Gaussians in a box 2 to 6 units away; at 640×480 most are some pixels wide, whatever their number."""
    g = torch.Generator().manual_seed(seed)
    means = torch.rand(count, 3, generator=g) * 2 - 1
    means[:, 2] = means[:, 2] * 2 + 4
    focal = 700 * width / 640
    return Cloud(
        means=means,
        quats=torch.randn(count, 4, generator=g),
        scales=torch.exp(torch.randn(count, 3, generator=g) * 0.4 - 4.2),
        opacities=torch.rand(count, generator=g) * 0.9 + 0.05,
        colors=torch.rand(count, 3, generator=g),
        viewmat=torch.eye(4),
        K=torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]),
        width=width,
        height=height,
    )

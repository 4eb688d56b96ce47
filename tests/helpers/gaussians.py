"""Random Gaussians, a camera in front of them, and learning rates."""

from __future__ import annotations

import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.optimizer import LearningRates

RATES = LearningRates(
    means_initial=1e-2, means_final=1e-4, means_steps=50, sh_dc=2.5e-3, sh_rest=1e-4, opacity_logits=0.05,
    log_scales=5e-3, quats=1e-3,
)  # fmt: skip


def random_gaussians(count: int, seed: int, degree: int | None, channels: int) -> list[torch.Tensor]:
    """means, quats, scales, opacities, colors (float32) of a cloud before a camera at the origin."""
    g = torch.Generator().manual_seed(seed)
    means = torch.cat([torch.rand(count, 2, generator=g) * 3 - 1.5, torch.rand(count, 1, generator=g) * 4 + 1], 1)
    quats = torch.randn(count, 4, generator=g)
    scales = torch.exp(torch.randn(count, 3, generator=g) * 0.5 - 2)
    opacities = torch.rand(count, generator=g) * 0.98 + 0.01
    if degree is None:
        colors = torch.rand(count, channels, generator=g)
    else:
        colors = torch.randn(count, (degree + 1) ** 2, channels, generator=g) * 0.3
    return [means, quats, scales, opacities, colors]


def model(channels: int, degree: int, count: int = 7) -> Gaussians:
    g = torch.Generator().manual_seed(channels)
    shapes = {
        "means": (3,),
        "log_scales": (3,),
        "quats": (4,),
        "opacity_logits": (),
        "sh": ((degree + 1) ** 2, channels),
    }
    return Gaussians(**{name: torch.randn(count, *shape, generator=g) for name, shape in shapes.items()})


def turned_camera(width: int, height: int) -> tuple[torch.Tensor, torch.Tensor]:
    """viewmats (1, 4, 4) and Ks (1, 3, 3) of a camera that is turned, moved and off-centre."""
    c, s = torch.cos(torch.tensor(0.2)).item(), torch.sin(torch.tensor(0.2)).item()
    view = torch.tensor([[c, 0, s, 0.1], [0, 1, 0, -0.05], [-s, 0, c, 0.3], [0, 0, 0, 1]])
    K = torch.tensor([[width * 0.9, 0, width * 0.5 + 2], [0, width * 0.92, height * 0.5 - 3], [0, 0, 1]])
    return view[None], K[None]

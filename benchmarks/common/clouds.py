"""Random Gaussians in front of a camera, and their render through autograd."""

from __future__ import annotations

import torch
from torch import Tensor

from tdgbench.bench.backend_check.compare import NAMES, Cloud
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole, Render


def random_cloud(count: int, width: int, height: int, seed: int = 0) -> Cloud:
    """Random Gaussians in a box 2 to 6 units away; at 640×480 most are a few pixels wide."""
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


def leaves_of(cloud: Cloud) -> list[Tensor]:
    """Copies of a cloud's tensors in the order of NAMES, with gradients enabled."""
    return [getattr(cloud, name).clone().requires_grad_() for name in NAMES]


def view_of(cloud: Cloud, leaves: list[Tensor], depth: bool = True) -> Render:
    """Colour and depth of a cloud by the fast core; `leaves` are its tensors (see `leaves_of`)."""
    camera = Pinhole(cloud.viewmat, cloud.K, cloud.width, cloud.height).to(leaves[0])
    return render_view(GaussianTensors(*leaves), camera, depth=depth, backend="cpu")  # type: ignore[arg-type]

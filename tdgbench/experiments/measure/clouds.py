"""Inputs of measurements: Gaussians in front of a camera, random or from a trained model."""

from __future__ import annotations

from pathlib import Path

import torch

from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.scenes import FolderDataset, ReadOptions
from tdgbench.splats.backends.reference import seen_colors
from tdgbench.splats.ply import load_ply
from tdgbench.splats.view import Pinhole


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


def trained_cloud(ply: Path, scene_folder: Path, view: int = 0) -> Cloud:
    """`model.ply` of a cell and a test camera of the capture it was trained on; one channel becomes three."""
    gaussians = load_ply(ply)
    scene = FolderDataset(str(scene_folder), ReadOptions()).load(None)
    camera = Pinhole.of(scene.test[view].camera).to(gaussians.means)
    colors = seen_colors(gaussians.activated(gaussians.sh_degree), torch.arange(len(gaussians)), camera)
    return Cloud(
        means=gaussians.means,
        quats=gaussians.quats,
        scales=gaussians.scales,
        opacities=gaussians.opacities,
        colors=colors.expand(-1, 3).contiguous(),
        viewmat=camera.viewmat,
        K=camera.K,
        width=camera.width,
        height=camera.height,
    )

"""Compile kernels before the clock of a training starts."""

from __future__ import annotations

import numpy as np
import torch

from tdgbench.fields import DensityField, FieldAdam, GridOptions
from tdgbench.scenes import Camera
from tdgbench.splats.backends import choose_backend, load_backend
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.initialize import gaussians_from_points
from tdgbench.splats.view import Pinhole
from tdgbench.training.budget import Budget
from tdgbench.training.context import training_device
from tdgbench.training.losses import inverse_expected_depth, min_max, thermal_loss
from tdgbench.training.splat_model import SplatModel

_SIZE = 16  # px


def compile_kernels(
    channels: set[int], budget: Budget, backend: str, *, depth: bool = True, masked: bool = False
) -> None:
    """Compile the kernels of trainings with these numbers of channels, by steps on a toy scene.

    depth: the loss takes rendered depth, so that its gradient is needed, too. masked: some views have a mask,
    for which the losses have kernels of their own.
    """
    chosen = load_backend(choose_backend(backend, training_device(backend), torch.float32))
    with chosen.compiling(channels, depth):
        _take_steps(channels, budget, backend, depth, masked)


def compile_field_kernels(backend: str) -> None:
    """Compile the kernels of radiance fields, by a step of a small one."""
    field = DensityField(GridOptions(2, 4, 8, 8, 8, 1.0), 1, torch.Generator().manual_seed(0)).to(
        training_device(backend)
    )
    optimizer = FieldAdam(field.parameters(), 0.01)
    densities, features = field(torch.rand(8, 3, device=training_device(backend)))
    (densities.sum() + features.sum()).backward()
    optimizer.step()


def _take_steps(channels: set[int], budget: Budget, backend: str, depth: bool, masked: bool) -> None:
    """Take three steps for each channel count: of one view; of two, with their depth if needed; through a hook."""
    pose = np.eye(4)
    pose[2, 3] = 2.0
    K = np.array([[_SIZE, 0, _SIZE / 2], [0, _SIZE, _SIZE / 2], [0, 0, 1.0]])
    camera = Camera(K, pose, _SIZE, _SIZE)
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (8, 3))
    for count in sorted(channels):
        start = gaussians_from_points(points, np.full((8, max(count, 3)), 0.5), count, budget.sh_degree)
        start = start.map(lambda tensor: tensor.to(training_device(backend)))
        model = SplatModel(start, budget, 1.0, backend, torch.Generator().manual_seed(0))
        for iteration, views in enumerate((1, 2, 1), start=1):  # gradients of two take other kernels than those of one
            model.begin(iteration)
            hook = Gaussians.activated if iteration == 3 else None
            for _ in range(views):
                render = model.render(camera, depth=depth and views == 2, hook=hook)
                black = torch.zeros_like(render.image)
                loss = thermal_loss(render.image, black, 0.2, 0.1, "written")
                if masked:
                    loss = loss + thermal_loss(render.image, black, 0.2, 0.1, "written", black[..., 0] == 0)
                if render.depth is not None:
                    loss = loss + min_max(inverse_expected_depth(render.depth, render.transmittance, 1e-3)).mean()
                loss.backward()
            model.step(iteration)
        with torch.no_grad():
            model.render(camera, depth=True)  # as held-out views are
        for rule in budget.active_rules:
            rule.warm_up(model.gaussians, Pinhole.of(camera), backend)
        model.optimizer.flush()

"""Backward passes over a state in training, whose gradients nobody has read yet."""

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import StateOptions
from tdgbench.splats.gradients import Gradients, PendingGradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.render import render_state
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import Pinhole
from tests.helpers.gaussians import RATES, random_gaussians, turned_camera

COUNT, WIDTH, HEIGHT = 120, 50, 40


class BackwardPass(NamedTuple):
    """Images, and what a step needs."""

    outputs: list[Tensor]  # image, depth, transmittance
    gradients: Gradients | PendingGradients
    optimizer: Adam

    @property
    def state(self) -> TrainingState:
        return self.optimizer.state


def cloud(channels: int, degree: int, dtype=torch.float32, count: int = COUNT) -> Gaussians:
    means, quats, scales, opacities, sh = random_gaussians(count, 4, degree, channels)
    return Gaussians(means, scales.log(), quats, opacities.logit(), sh).map(lambda t: t.to(dtype))


def with_rgb(given: Gaussians) -> Gaussians:
    """Return Gaussians with a second colour set `sh_rgb` and a second opacity `opacity_rgb`."""
    _, _, _, opacities, sh = random_gaussians(len(given), 5, given.sh_degree, 3)
    fields = {"sh_rgb": sh, "opacity_rgb": opacities.logit()[:, None]}
    return replace(given, extra_fields={name: tensor.to(given.means) for name, tensor in fields.items()})


def backward_pass(given: Gaussians, backend: str, used_degree: int, **of_view) -> BackwardPass:
    """Of a loss with random slopes, the same ones for every backend."""
    state = TrainingState(given)
    view, K = (t[0] for t in turned_camera(WIDTH, HEIGHT))
    collected = []
    optimizer = Adam(state, RATES, 1.0, dict.fromkeys(given.extra_fields, 1e-3))
    options = StateOptions(used_degree, **{"depth": True, **of_view}, tolerance=optimizer.tolerance(1))
    rendered = render_state(state, optimizer, Pinhole(view, K, WIDTH, HEIGHT), options, collected.append, backend)
    outputs = [o for o in (rendered.image, rendered.depth, rendered.transmittance) if o is not None]
    g = torch.Generator().manual_seed(0)
    loss = sum((o * torch.randn(o.shape, generator=g, dtype=torch.float64).to(o)).sum() for o in outputs)
    loss.backward()
    (gradients,) = collected
    return BackwardPass([o.detach().double() for o in outputs], gradients, optimizer)

"""Stress: losses of degenerate images and depth maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from methods.tdg import DepthTarget, depth_loss
from tdgbench.bench.backend_check.compare import BackendErrors
from tdgbench.experiments.stress.case import Case, close, require_close
from tdgbench.priors import DepthPrior
from tdgbench.training.losses import inverse_expected_depth, l1, min_max, smoothness, ssim, thermal_loss

_FAMILY = "losses"
_SIZE = (24, 32)
_TOLERANCES = BackendErrors(1e-4, 1e-3)

Loss = Callable[[Tensor], Tensor]


def cases() -> list[Case]:
    """Return every case of this family. They run once: losses do not depend on the backend."""
    return [
        Case(_FAMILY, name, close(_TOLERANCES), partial(_fused_against_torch, loss, at), False)
        for name, loss, at in _losses()
    ]


def _losses() -> list[tuple[str, Loss, Tensor]]:
    """Return name, loss, and the tensor at which its value and gradient are compared."""
    black, white, noise = torch.zeros(*_SIZE, 1), torch.ones(*_SIZE, 1), _noise(0)
    depth, pixel = _noise(1)[..., 0] * 5 + 1, torch.ones(1, 1, 1)
    clear, other = torch.zeros(*_SIZE), _noise(2)[..., 0] * 5 + 1
    return [
        ("SSIM of two black images", lambda x: ssim(x, black.to(x)), black),
        ("SSIM of two white images", lambda x: ssim(x, white.to(x)), white),
        ("SSIM of black and white", lambda x: ssim(x, white.to(x)), black),
        ("L1 of equal images", lambda x: l1(x, noise.to(x)), noise),
        ("smoothness of a constant image", lambda x: smoothness(x, "written"), white),
        ("the thermal loss of one pixel", lambda x: thermal_loss(x, pixel.to(x), 0.2, 0.6, "written"), 0 * pixel),
        ("the same, wrapped around", lambda x: thermal_loss(x, pixel.to(x), 0.2, 0.6, "released"), 0 * pixel),
        ("the thermal loss of one row", lambda x: thermal_loss(x, noise[:1].to(x), 0.2, 0.6, "written"), noise[1:2]),
        ("the thermal loss of values of 1e6", lambda x: thermal_loss(x, noise.to(x), 0.2, 0.6, "written"), noise * 1e6),
        ("min-max of a constant map", lambda x: min_max(x).sum(), clear + 3),
        ("min-max of a range of 1e-7", lambda x: min_max(x).square().sum(), 1 + 1e-7 * depth),
        ("min-max of values of 1e9", lambda x: min_max(x).square().sum(), 1e9 * depth),
        ("inverse depth where nothing is", lambda x: inverse_expected_depth(x, (clear + 1).to(x), 1e-3).sum(), clear),
        ("inverse depth of 1e-6", lambda x: inverse_expected_depth(x, (clear + 0.5).to(x), 1e-3).mean(), clear + 1e-6),
        ("constant depth and constant prior", _against(clear + 2), clear + 5),
        ("constant prior", _against(clear + 2), depth),
        ("constant depth", _against(depth), clear + 5),
        ("a prior known at one pixel", _against(_masked(depth, 1)), other),
        ("a prior known at half of the pixels", _against(_masked(depth, depth.numel() // 2)), other),
        ("a prior of the wrong sign", _against(-depth), depth),
    ]


def _noise(seed: int) -> Tensor:
    return torch.rand(*_SIZE, 1, generator=torch.Generator().manual_seed(seed))


def _masked(values: Tensor, known: int) -> Tensor:
    flat = torch.full((values.numel(),), float("nan"))
    flat[:known] = values.flatten()[:known]
    return flat.view_as(values)


def _against(prior: Tensor) -> Loss:
    def loss(rendered: Tensor) -> Tensor:
        target = DepthTarget.from_prior(DepthPrior(prior.numpy().astype(np.float32), "depth"), rendered.device)
        target = replace(target, normalised=target.normalised.to(rendered))
        return depth_loss(rendered, target)

    return loss


def _fused_against_torch(loss: Loss, at: Tensor, _backend: str) -> str:
    """Compare value and gradient in float32, which the fused kernels compute, with torch in float64."""
    values, gradients = [], []
    for dtype in (torch.float64, torch.float32):
        x = at.to(dtype).clone().requires_grad_()
        value = loss(x)
        value.backward()
        values.append(value.detach().double())
        gradients.append(torch.zeros_like(x) if x.grad is None else x.grad.double())
    usual = at.numel() ** -0.5 * at.abs().max().clamp_min(1.0).reciprocal()  # gradient of a mean over the pixels
    gradient_error = (gradients[1] - gradients[0]).norm() / gradients[0].norm().clamp_min(usual)
    error = (values[1] - values[0]).abs() / values[0].abs().clamp_min(1.0)
    errors = require_close(BackendErrors(error.item(), gradient_error.item()), _TOLERANCES)
    return f"loss {values[0].item():.4g}; {errors}"

"""Does a scene look different from different sides? Asked of training views before the harmonics grow.

At degree 0, what each Gaussian leaves unexplained in a view is the mean of the residual over the pixels it covers,

    r_iv = Σ_p w_ip (T − I)_p / Σ_p w_ip ,

both sums being gradients of a render. If appearance depends on direction, r_iv follows the direction d_iv from which
view v sees Gaussian i. So r_i· is fitted by a linear function of d_i· on half of the views, and the other half tells
how much of it that explains: a cross-validated R², at most 0 for noise.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tdgbench.scenes import View
from tdgbench.splats import Gaussians
from tdgbench.splats.harmonics import colors_from_sh
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole

MOST_VIEWS = 24
RIDGE = 1e-2
MIN_WEIGHT = 1.0  # pixels' worth of light; what covers less in a view says nothing


def explained_by_direction(gaussians: Gaussians, views: list[View], targets: list[Tensor], backend: str) -> float:
    """R² (at most 1) of the residuals of `targets` (H, W, C) by direction; 0 if there are fewer than 4 views."""
    if len(views) < 4:
        return 0.0
    step = max(1, len(views) // MOST_VIEWS)
    chosen = list(zip(views, targets, strict=True))[::step]
    centre_of = gaussians.means.new_tensor
    residuals, weights, directions = [], [], []
    for view, target in chosen:
        residual, weight = _residuals(gaussians, view, target, backend)
        residuals.append(residual)
        weights.append(weight)
        away = gaussians.means - centre_of(view.camera.center)
        directions.append(torch.nn.functional.normalize(away, dim=1))
    r, w, d = torch.stack(residuals), torch.stack(weights), torch.stack(directions)  # (V, N, C), (V, N), (V, N, 3)
    explained, total = 0.0, 0.0
    for own, other in ((slice(0, None, 2), slice(1, None, 2)), (slice(1, None, 2), slice(0, None, 2))):
        before, after = _held_out_error(r[own], w[own], d[own], r[other], w[other], d[other])
        explained, total = explained + before - after, total + before
    return explained / total if total > 0 else 0.0


def _residuals(gaussians: Gaussians, view: View, target: Tensor, backend: str) -> tuple[Tensor, Tensor]:
    """Mean residual (N, C) of each Gaussian in a view, and the light Σ_p w_ip (N,) that it sends there."""
    with torch.enable_grad():
        colors = colors_from_sh(gaussians.sh[:, :1], torch.zeros_like(gaussians.means), 0)
        colors = colors.detach().requires_grad_()
        coloured = GaussianTensors(gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, colors)
        rendered = render_view(coloured, Pinhole.of(view.camera).to(colors), backend=backend)
        pulled, light = [
            torch.autograd.grad(rendered.image, colors, weight, retain_graph=not last)[0]
            for weight, last in ((target - rendered.image.detach(), False), (torch.ones_like(target), True))
        ]
    weight = light[:, 0]
    return pulled / weight.clamp_min(1e-9)[:, None], torch.where(weight >= MIN_WEIGHT, weight, 0.0)


def _held_out_error(r, w, d, r_other, w_other, d_other) -> tuple[float, float]:
    """Weighted square of the other views' residuals, less their constant part: before the fit and after it."""
    ones = torch.ones_like(d[..., :1])
    design, design_other = torch.cat([ones, d], dim=-1), torch.cat([ones, d_other], dim=-1)
    weighted = design * w[..., None]
    normal = torch.einsum("vni,vnj->nij", weighted, design)
    penalty = w.sum(dim=0)[:, None, None] * RIDGE * torch.diag(torch.tensor([0.0, 1.0, 1.0, 1.0])).to(normal)
    normal = normal + penalty + 1e-6 * torch.eye(4).to(normal)
    right = torch.einsum("vni,vnc->nic", weighted, r)
    fit = torch.linalg.solve(normal, right)
    constant = right[:, :1] / w.sum(dim=0).clamp_min(1e-6)[:, None, None]
    errors = []
    for predicted in (constant.squeeze(1)[None], torch.einsum("vni,nic->vnc", design_other, fit)):
        errors.append((w_other[..., None] * (r_other - predicted).square()).sum().item())
    return errors[0], errors[1]

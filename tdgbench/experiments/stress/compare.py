"""Compare values and gradients of a cloud on a backend with those of the float64 reference.

A rounding error can flip one of the blend's two thresholds at a pixel. Such pixels are found by moving the thresholds
slightly; they are counted, and excluded from the comparison.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from tdgbench.experiments.measure.clouds import Cloud
from tdgbench.experiments.measure.oracle import NAMES
from tdgbench.experiments.stress.outcome import Observed
from tdgbench.splats import rasterization
from tdgbench.splats.backends import load_backend
from tdgbench.splats.blending import AS_3DGS, Blending

MOVED = 1e-4  # relative change of the thresholds that reveals undecided pixels
SMALL = 1e-4  # share of the largest gradient that smaller gradients are measured against
MAX_ALPHA_OF_GSPLAT = 0.999


def cloud(count: int, seed: int = 0, width: int = 40, height: int = 30, degree: int | None = None) -> Cloud:
    """A random cloud 1 to 5 units in front of a turned, off-centre camera."""
    g = torch.Generator().manual_seed(seed)
    means = torch.cat([torch.rand(count, 2, generator=g) * 3 - 1.5, torch.rand(count, 1, generator=g) * 4 + 1], dim=1)
    shape = (count, 1) if degree is None else (count, (degree + 1) ** 2, 1)
    colors = torch.rand(shape, generator=g) if degree is None else 0.3 * torch.randn(shape, generator=g)
    angle = torch.tensor(0.2)
    cosine, sine = angle.cos().item(), angle.sin().item()
    viewmat = torch.tensor([[cosine, 0, sine, 0.1], [0, 1, 0, -0.05], [-sine, 0, cosine, 0.3], [0, 0, 0, 1]])
    K = torch.tensor([[width * 0.9, 0, width * 0.5 + 2], [0, width * 0.92, height * 0.5 - 3], [0, 0, 1]])
    return Cloud(
        means=means,
        quats=torch.randn(count, 4, generator=g),
        scales=torch.exp(torch.randn(count, 3, generator=g) * 0.5 - 2),
        opacities=torch.rand(count, generator=g) * 0.98 + 0.01,
        colors=colors,
        viewmat=viewmat,
        K=K,
        width=width,
        height=height,
        degree=degree,
    )


def render(scene: Cloud, backend: str, weights: Tensor | None = None, blending: Blending = AS_3DGS):
    """Image with depth and alpha (H, W, D + 2), and gradients by name of its sum weighted by `weights`; all float64."""
    kind: dict[str, Any] = {"dtype": torch.float64 if backend == "reference" else torch.float32}
    kind["device"] = load_backend(backend).device
    leaves = [
        p.detach().to(**kind).requires_grad_(weights is not None) for p in (getattr(scene, name) for name in NAMES)
    ]
    means, quats, scales, opacities, colors = leaves
    viewmats, Ks = (t.to(**kind)[None] for t in (scene.viewmat, scene.K))
    renders, alphas, _ = rasterization(
        means, quats, scales, opacities, colors, viewmats, Ks, scene.width, scene.height, sh_degree=scene.degree,
        render_mode="RGB+D", near_plane=scene.near_plane, backend=backend,
        blending=AS_3DGS if backend == "cuda" else blending,
    )  # fmt: skip
    image = torch.cat([renders[0], alphas[0]], dim=-1)
    if weights is not None:
        (image * weights.to(image)).sum().backward()
    gradients = [torch.zeros_like(leaf) if leaf.grad is None else leaf.grad for leaf in leaves]
    return image.detach().double().cpu(), {n: g.double().cpu() for n, g in zip(NAMES, gradients, strict=True)}


def compared(scene: Cloud, backend: str, seed: int = 0) -> Observed:
    """Largest errors of a pixel, relative to its channel's range (at least 1), and of a gradient, to its norm."""
    constants = replace(AS_3DGS, max_alpha=MAX_ALPHA_OF_GSPLAT) if backend == "cuda" else AS_3DGS
    low, high = (render(scene, "reference", None, constants.moved(f))[0] for f in (1 - MOVED, 1 + MOVED))
    scale = high.abs().amax(dim=(0, 1)).clamp_min(1.0) if high.numel() else torch.ones(high.shape[-1])
    undecided = ((low - high).abs() / scale).amax(dim=-1) > 1e-6
    weights = torch.randn(high.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    weights = weights / scale * (~undecided)[..., None]
    want, want_gradients = render(scene, "reference", weights, constants)
    got, got_gradients = render(scene, backend, weights, constants)
    error = torch.where(undecided, 0.0, ((got - want).abs() / scale).amax(dim=-1))
    floor = SMALL * torch.stack([gradient.norm() for gradient in want_gradients.values()]).max()
    errors = [_relative(got_gradients[name], gradient, floor) for name, gradient in want_gradients.items()]
    excluded = undecided.double().mean().item()
    return Observed(
        numbers={
            "image": _largest(error),
            "gradients": _largest(torch.stack(errors)),
            **({"pixels left out": excluded} if excluded else {}),
        }
    )


def _relative(got: Tensor, want: Tensor, floor: Tensor) -> Tensor:
    """Norm of the difference of two gradients, relative to that of `want`, but at least to `floor`."""
    difference = (got - want).norm()
    return torch.where(difference == 0, difference, difference / want.norm().maximum(floor).clamp_min(1e-12))


def _largest(values: Tensor) -> float:
    """Largest value; NaN if any value is NaN, 0 if there are no values."""
    if values.numel() == 0:
        return 0.0
    return float("nan") if bool(values.isnan().any()) else values.max().item()

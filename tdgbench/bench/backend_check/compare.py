"""Compare values and gradients of a cloud on a backend with those of the float64 reference.

A rounding error can flip one of the blend's two thresholds at a pixel. Such pixels are found by moving the thresholds
slightly; they are counted, and excluded from the comparison.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from tdgbench.splats import rasterization
from tdgbench.splats.backends import load_backend
from tdgbench.splats.view import AS_3DGS, NEAR_PLANE, Blending

NAMES = ("means", "quats", "scales", "opacities", "colors")
IMAGE_TOLERANCE, GRADIENT_TOLERANCE = 5e-5, 2e-4  # of a float32 backend's errors
MOVED = 1e-4  # relative change of the thresholds that reveals undecided pixels
SMALL = 1e-4  # share of the largest gradient that smaller gradients are measured against


@dataclass
class Cloud:
    """Gaussians and a camera, as `rasterization` takes them.

    means (N, 3) world units; quats (N, 4) wxyz; scales (N, 3) world units; opacities (N,); colors (N, D), or (N, K, D)
    with SH `degree`; viewmat (4, 4); K (3, 3) px.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    viewmat: Tensor
    K: Tensor
    width: int
    height: int
    degree: int | None = None
    near_plane: float = NEAR_PLANE
    background: Tensor | None = None  # (D,)
    absgrad: bool = False  # whether absolute gradients of image means are compared, too


class Rendered(NamedTuple):
    """What a backend computes of a cloud; float64, on the CPU."""

    image: Tensor  # (H, W, D + 2): colours, accumulated depth, alpha
    gradients: dict[str, Tensor]  # of a weighted sum of `image`, by the names in NAMES, `means2d`, `absgrad` (N, 2)
    radii: Tensor  # (N,) px


class BackendErrors(NamedTuple):
    """Largest errors of a pixel, relative to its channel's range (at least 1), and of a gradient, to its norm."""

    image: float
    gradients: float  # both are NaN if a value is


@dataclass(frozen=True)
class Expected:
    """What the reference computes of a cloud in float64, and where a float32 backend is compared with it."""

    rendered: Rendered
    weights: Tensor  # (H, W, D + 2) of the sum whose gradients are compared; 0 at undecided pixels
    scale: Tensor  # (D + 2,): range of each channel
    undecided: Tensor  # (H, W) bool: pixels that a rounding error could flip

    def errors(self, got: Rendered, names: Sequence[str] = NAMES) -> BackendErrors:
        """Return the errors of what a backend computed with these weights. names: of the gradients to compare."""
        image = ((got.image - self.rendered.image).abs() / self.scale).amax(dim=-1)
        want = {name: self.rendered.gradients[name] for name in names}
        floor = SMALL * torch.stack([gradient.norm() for gradient in want.values()]).max()
        gradients = [_relative(got.gradients[name], gradient, floor) for name, gradient in want.items()]
        return BackendErrors(_largest(torch.where(self.undecided, 0.0, image)), _largest(torch.stack(gradients)))


def cloud(
    count: int, seed: int = 0, width: int = 40, height: int = 30, degree: int | None = None, channels: int = 1
) -> Cloud:
    """Return a random cloud 1 to 5 units in front of a turned, off-centre camera."""
    g = torch.Generator().manual_seed(seed)
    means = torch.cat([torch.rand(count, 2, generator=g) * 3 - 1.5, torch.rand(count, 1, generator=g) * 4 + 1], dim=1)
    shape = (count, channels) if degree is None else (count, (degree + 1) ** 2, channels)
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


def render(scene: Cloud, backend: str, weights: Tensor | None = None, blending: Blending = AS_3DGS) -> Rendered:
    """Render a cloud; with weights (H, W, D + 2), also the gradients of the weighted sum of its image.

    `reference` computes in float64, all others in float32. blending: of a backend that has no constants of its own.
    """
    own = load_backend(backend)
    kind: dict[str, Any] = {"dtype": torch.float64 if backend == "reference" else torch.float32, "device": own.device}
    leaves = [
        p.detach().to(**kind).requires_grad_(weights is not None) for p in (getattr(scene, name) for name in NAMES)
    ]
    means, quats, scales, opacities, colors = leaves
    viewmats, Ks = (t.to(**kind)[None] for t in (scene.viewmat, scene.K))
    renders, alphas, meta = rasterization(
        means, quats, scales, opacities, colors, viewmats, Ks, scene.width, scene.height, sh_degree=scene.degree,
        render_mode="RGB+D", near_plane=scene.near_plane, backend=backend, absgrad=scene.absgrad,
        backgrounds=None if scene.background is None else scene.background.to(**kind)[None],
        blending=blending if own.constants() is None else AS_3DGS,
    )  # fmt: skip
    image = torch.cat([renders[0], alphas[0]], dim=-1)
    if weights is not None:
        (image * weights.to(image)).sum().backward()
    tensors = dict(zip((*NAMES, "means2d"), (*leaves, meta["means2d"][0]), strict=True))
    gradients = {n: (torch.zeros_like(t) if t.grad is None else t.grad).double().cpu() for n, t in tensors.items()}
    if scene.absgrad:
        gradients["absgrad"] = meta["absgrad"][0].double().cpu()
    return Rendered(image.detach().double().cpu(), gradients, meta["radii"][0].cpu())


def expected(scene: Cloud, backend: str, seed: int = 0) -> Expected:
    """Return what a backend should compute of a cloud, with that backend's constants. seed: of the weights."""
    constants = load_backend(backend).constants() or AS_3DGS
    low, high = (render(scene, "reference", None, constants.moved(f)).image for f in (1 - MOVED, 1 + MOVED))
    scale = high.abs().amax(dim=(0, 1)).clamp_min(1.0) if high.numel() else torch.ones(high.shape[-1])
    undecided = ((low - high).abs() / scale).amax(dim=-1) > 1e-6
    weights = torch.randn(high.shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    weights = weights / scale * (~undecided)[..., None]
    return Expected(render(scene, "reference", weights, constants), weights, scale, undecided)


def _relative(got: Tensor, want: Tensor, floor: Tensor) -> Tensor:
    """Return the norm of the difference of two gradients, relative to that of `want`, but at least to `floor`."""
    difference = (got - want).norm()
    return torch.where(difference == 0, difference, difference / want.norm().maximum(floor).clamp_min(1e-12))


def _largest(values: Tensor) -> float:
    """Return the largest value; NaN if any value is NaN, 0 if there are no values."""
    return values.max().item() if values.numel() else 0.0

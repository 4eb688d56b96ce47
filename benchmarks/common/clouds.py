"""Gaussians in front of a camera, random or of a trained model, and their exact render: in plain torch, tile by tile.

In float64 this render is the oracle at full size, in float32 the speed without a compiler. Each tile is blended with
the Gaussians whose alpha can exceed min_alpha in it; the others contribute exactly nothing. So the result is that of
`tdgbench.splats.backends.reference`, whose functions this uses, in the memory of one tile.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.scenes import FolderDataset, ReadOptions
from tdgbench.splats.backends import load_backend, reference
from tdgbench.splats.backends.reference import seen_colors
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.ply import load_ply
from tdgbench.splats.render import render_view
from tdgbench.splats.view import EPS2D, NEAR_PLANE, GaussianTensors, Pinhole, Render


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


TILE = 32
NAMES = ("means", "quats", "scales", "opacities", "colors")


@dataclass
class Result:
    """Image with depth as its last channel (H, W, D + 1), transmittance (H, W), gradients by name."""

    image: Tensor
    transmittance: Tensor
    gradients: dict[str, Tensor]


def leaves_of(cloud: Cloud, dtype: torch.dtype, device: str = "cpu") -> list[Tensor]:
    """Copies of a cloud's tensors in the order of NAMES, with gradients enabled."""
    given = [getattr(cloud, name) for name in NAMES]
    return [t.to(device, dtype).clone().requires_grad_() for t in given]


def device_of(backend: str) -> str:
    """Device that a fast backend expects its tensors on."""
    return load_backend(backend).device


def view_of(cloud: Cloud, leaves: list[Tensor], backend: str, depth: bool = True) -> Render:
    """Colour and depth of a cloud on a fast backend; `leaves` are its tensors (see `leaves_of`)."""
    camera = Pinhole(cloud.viewmat, cloud.K, cloud.width, cloud.height).to(leaves[0])
    gaussians = GaussianTensors(*leaves)  # type: ignore[arg-type]
    return render_view(gaussians, camera, depth=depth, backend=backend)


def on_backend(cloud: Cloud, backend: str, weights: Tensor) -> Result:
    """Image and gradients of a cloud on a fast backend in float32; `render` is the oracle. weights: (H, W, D + 2)."""
    leaves = leaves_of(cloud, torch.float32, device_of(backend))
    view = view_of(cloud, leaves, backend)
    image = torch.cat([view.image, view.requested_depth[..., None]], dim=-1)
    w = weights.to(image)
    ((image * w[..., :-1]).sum() + (view.transmittance * w[..., -1]).sum()).backward()
    gradients = {name: leaf.grad.cpu() for name, leaf in zip(NAMES, leaves, strict=True) if leaf.grad is not None}
    return Result(image.detach().cpu(), view.transmittance.detach().cpu(), gradients)


def render(cloud: Cloud, dtype: torch.dtype, weights: Tensor | None, blending: Blending = AS_3DGS) -> Result:
    """Image and transmittance of a cloud; with weights, also the gradients of their weighted sum.

    weights: (H, W, D + 2), of image, depth and transmittance.
    """
    leaves = leaves_of(cloud, dtype)
    means, quats, scales, opacities, colors = leaves
    view, K = cloud.viewmat.to(dtype), cloud.K.to(dtype)
    in_front = ((means @ view[2, :3] + view[2, 3]).detach() > NEAR_PLANE).nonzero().squeeze(1)
    front_means, front_quats, front_scales = (t[in_front] for t in (means, quats, scales))
    means2d, conics, covariance, z = reference.project(
        front_means, front_quats, front_scales, view, K, cloud.width, cloud.height, EPS2D
    )
    order = torch.argsort(z.detach(), stable=True)
    channels = torch.cat([colors[in_front], z[:, None]], dim=1)
    projected = [t[order] for t in (means2d, conics, opacities[in_front], channels)]
    held = [t.detach().requires_grad_(weights is not None) for t in projected]
    # alpha ≤ opacity · exp(−d² / (2 λ)), d the distance to the tile and λ the larger eigenvalue of the covariance
    largest = torch.linalg.eigvalsh(covariance.detach())[order, 1]
    cutoff = (2 * largest * (held[2].detach() / blending.min_alpha).clamp_min(1).log()).sqrt() + 1e-3
    image = torch.zeros(cloud.height, cloud.width, channels.shape[1], dtype=dtype)
    transmittance = torch.ones(cloud.height, cloud.width, dtype=dtype)
    for top in range(0, cloud.height, TILE):
        for left in range(0, cloud.width, TILE):
            rows, columns = slice(top, min(top + TILE, cloud.height)), slice(left, min(left + TILE, cloud.width))
            corner = torch.tensor([left, top], dtype=dtype) + 0.5
            end = torch.tensor([columns.stop, rows.stop], dtype=dtype) - 0.5
            centre = held[0].detach()
            near = ((centre - centre.clamp(corner, end)).norm(dim=1) <= cutoff).nonzero().squeeze(1)
            if len(near) == 0:
                continue
            ys, xs = torch.meshgrid(
                torch.arange(rows.start, rows.stop), torch.arange(columns.start, columns.stop), indexing="ij"
            )
            pixels = torch.stack([xs, ys], dim=-1).reshape(-1, 2).to(dtype) + 0.5
            near_means, near_conics, near_opacities, near_channels = (h[near] for h in held)
            light, t = reference.blend(pixels, near_means, near_conics, near_opacities, near_channels, blending)
            image[rows, columns] = light.detach().reshape(*xs.shape, -1)
            transmittance[rows, columns] = t.detach().reshape(xs.shape)
            if weights is not None:
                w = weights[rows, columns].reshape(len(pixels), -1).to(dtype)
                ((light * w[:, :-1]).sum() + (t * w[:, -1]).sum()).backward()
    gradients: dict[str, Tensor] = {}
    if weights is not None:
        torch.autograd.backward(projected, [torch.zeros_like(h) if h.grad is None else h.grad for h in held])
        for name, leaf in zip(NAMES, leaves, strict=True):
            gradients[name] = torch.zeros_like(leaf) if leaf.grad is None else leaf.grad
    return Result(image, transmittance, gradients)

"""The exact render of a cloud, in plain torch, tile by tile: the oracle for sizes at which `reference` needs gigabytes.

Each tile is blended with the Gaussians whose alpha can exceed min_alpha in it; the others contribute exactly nothing.
So the result is that of `tdgbench.splats.backends.reference`, whose functions this uses, in the memory of one tile.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from benchmarks.common.clouds import NAMES, leaves_of
from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.splats.backends import reference
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.view import EPS2D, NEAR_PLANE

TILE = 32


@dataclass
class ExactRender:
    """Image with depth as its last channel (H, W, D + 1), transmittance (H, W), gradients by name."""

    image: Tensor
    transmittance: Tensor
    gradients: dict[str, Tensor]


def exact_render(cloud: Cloud, dtype: torch.dtype, weights: Tensor | None, blending: Blending = AS_3DGS) -> ExactRender:
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
    return ExactRender(image, transmittance, gradients)

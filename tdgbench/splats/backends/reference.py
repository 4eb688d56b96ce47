"""The `reference` backend: splatting in plain torch, for any float type and device. Slow; for small scenes.

It states the mathematics without tiles, boxes or shortcuts; all other backends are tested against it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import torch
from torch import Tensor

from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.geometry import project, screen_radii, seen_colors
from tdgbench.splats.view import Blending, GaussianTensors, Pinhole, Projection, Render, RenderOptions

PAIRS_AT_ONCE = 4_000_000  # pixel-Gaussian pairs in memory


def blend(pixels, means2d, conics, opacities, channels, blending, observe=None) -> tuple[Tensor, Tensor]:
    """Return light (P, D) and transmittance (P,) at pixel centres (P, 2) px, of Gaussians sorted from near to far.

    means2d (N, 2) px, conics (N, 3) px⁻², opacities (N,), channels (N, D). The backward pass calls observe(gradients
    (P, N, 2) of the negative image means, by pixel).
    """
    d = pixels[:, None, :] - means2d[None]
    if observe is not None and d.requires_grad:
        d.register_hook(observe)
    quadratic = conics[:, 0] * d[..., 0] ** 2 + conics[:, 2] * d[..., 1] ** 2
    power = -0.5 * quadratic - conics[:, 1] * d[..., 0] * d[..., 1]
    alpha = (opacities * power.exp()).clamp_max(blending.max_alpha)
    alpha = torch.where(alpha >= blending.min_alpha, alpha, 0.0)
    after = (1 - alpha).cumprod(dim=1)
    # `after` never grows: all Gaussians behind the stop are skipped
    alpha = torch.where(after >= blending.min_transmittance, alpha, 0.0)
    after = (1 - alpha).cumprod(dim=1)
    before = torch.cat([torch.ones_like(after[:, :1]), after[:, :-1]], dim=1)
    return (alpha * before) @ channels, after[:, -1]


class ReferenceBackend(Backend):
    """Any float tensors on any device, with autograd's gradients. The image means are part of the graph."""

    def render(self, gaussians: GaussianTensors, camera: Pinhole, options: RenderOptions) -> Render:
        means, quats, scales, opacities, _, _ = gaussians
        camera = camera.to(means)
        depths = means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
        in_front = ((depths > camera.near_plane) & (depths < camera.far_plane)).nonzero().squeeze(1)
        means2d, conics, covariance, z = project(
            means[in_front], quats[in_front], scales[in_front], camera.viewmat, camera.K, camera.width, camera.height,
            camera.eps2d,
        )  # fmt: skip
        radii = torch.zeros(len(means), dtype=torch.int32, device=means.device)
        radii[in_front] = screen_radii(means2d.detach(), covariance.detach(), camera.width, camera.height)
        zeros = torch.zeros(len(means), 2, dtype=means.dtype, device=means.device)
        all_means2d = zeros.index_put((in_front,), means2d)
        if all_means2d.requires_grad:
            all_means2d.retain_grad()
        channels = seen_colors(gaussians, in_front, camera)
        if options.depth:
            channels = torch.cat([channels, z[:, None]], dim=1)
        order = torch.argsort(z.detach(), stable=True)
        splats = (all_means2d[in_front][order], conics[order], opacities[in_front][order], channels[order])
        absgrad, observe = None, None
        if options.absgrad:
            absgrad = torch.zeros_like(zeros)
            observe = partial(_add_absolute, absgrad, in_front[order])
        light, transmittance = _blend_image(splats, camera, options.blending, observe)
        if bool(torch.stack([t.isnan().any() for t in (means, quats, scales, opacities)]).any()):
            light, transmittance = light * torch.nan, transmittance * torch.nan  # its place in the image is unknown
        image, depth = (light[..., :-1], light[..., -1]) if options.depth else (light, None)
        if options.background is not None:
            image = image + transmittance[..., None] * options.background.to(means.dtype)
        return Render(image, depth, transmittance, Projection(all_means2d, radii, depths.detach(), absgrad))


def _add_absolute(total: Tensor, index: Tensor, gradients: Tensor) -> None:
    """Add to total (N, 2), at an index (n,), the sums over pixels of the absolute gradients (P, n, 2)."""
    total.index_add_(0, index, gradients.abs().sum(dim=0))


def _blend_image(
    splats: tuple[Tensor, Tensor, Tensor, Tensor],
    camera: Pinhole,
    blending: Blending,
    observe: Callable[[Tensor], None] | None = None,
) -> tuple[Tensor, Tensor]:
    """Return light (H, W, D) and transmittance (H, W) of means2d, conics, opacities and channels; see `blend`."""
    means2d, _, _, channels = splats
    ys, xs = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    pixels = torch.stack([xs, ys], dim=-1).reshape(-1, 2).to(means2d.device, means2d.dtype) + 0.5
    if len(means2d) == 0:
        light = channels.new_zeros(len(pixels), 1) + channels.sum(dim=0) * 0.0  # keeps the graph
        transmittance = torch.ones(len(pixels), dtype=means2d.dtype, device=means2d.device)
    else:
        chunks = pixels.split(max(1, PAIRS_AT_ONCE // len(means2d)))
        parts = [blend(chunk, *splats, blending, observe) for chunk in chunks]
        light = torch.cat([part[0] for part in parts])
        transmittance = torch.cat([part[1] for part in parts])
    return light.reshape(camera.height, camera.width, -1), transmittance.reshape(camera.height, camera.width)


BACKEND = ReferenceBackend()

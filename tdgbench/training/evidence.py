"""Evidence for growth: what the footprints of Gaussians leave unexplained, view by view."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.backends.reference import rotation_matrices
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole

HALF = 0.6  # σ from a Gaussian's centre to those of its halves along its longest axis
NARROWER = (1 - HALF**2) ** 0.5  # σ of a half on that axis: both together have the Gaussian's second moment
FAINTER = 0.5 / NARROWER  # opacity of a half: both together have the Gaussian's mass


class Footprints(NamedTuple):
    """Sums over the footprints of N Gaussians in one view of C channels, each pixel weighted as in the blend."""

    weight: Tensor  # (N,) px
    residual: Tensor  # (N, C) signed, image values × px
    difference: Tensor  # (N, C) the residual in one half of the footprint minus that in the other
    visible: Tensor  # (N,) bool


@torch.no_grad()
def look_at(gaussians: Gaussians, camera: Camera, residual: Tensor, valid: Tensor | None, backend: str) -> Footprints:
    """Footprints of the Gaussians in a residual (H, W, C); masked pixels (`valid` (H, W) is false) count nothing.

    Each Gaussian is rendered as its two halves, without colour: the gradient of a half's colour is the sum over its
    footprint of what the image's gradient is set to.
    """
    counts = torch.ones_like(residual[..., :1]) if valid is None else valid[..., None].to(residual)
    known = residual if valid is None else torch.where(valid[..., None], residual, 0.0)  # NaN may be at masked pixels
    maps = torch.cat([counts, known], dim=-1)
    n = len(gaussians)
    parts = halves(gaussians)
    with torch.enable_grad():
        colors = parts.means.new_zeros(2 * n, maps.shape[2], requires_grad=True)
        view = render_view(parts._replace(colors=colors), Pinhole.of(camera).to(parts.means), backend=backend)
        view.image.backward(maps)
    sums = colors.grad
    assert sums is not None and view.projection is not None
    first, second = sums[:n], sums[n:]
    radii = view.projection.radii
    return Footprints(
        first[:, 0] + second[:, 0], first[:, 1:] + second[:, 1:], first[:, 1:] - second[:, 1:],
        (radii[:n] > 0) | (radii[n:] > 0),
    )  # fmt: skip


def halves(gaussians: Gaussians) -> GaussianTensors:
    """2N Gaussians without colour: the first halves of N Gaussians along their longest axes, then the second ones."""
    scales = gaussians.scales
    longest = scales.argmax(dim=1, keepdim=True)
    axes = rotation_matrices(gaussians.quats).gather(2, longest[:, None, :].expand(-1, 3, 1)).squeeze(2)
    offsets = HALF * scales.gather(1, longest) * axes
    narrow = scales.scatter(1, longest, NARROWER * scales.gather(1, longest))
    return GaussianTensors(
        torch.cat([gaussians.means + offsets, gaussians.means - offsets]),
        gaussians.quats.repeat(2, 1), narrow.repeat(2, 1), (FAINTER * gaussians.opacities).repeat(2),
        gaussians.means.new_zeros(0, 0),
    )  # fmt: skip


class Evidence(NamedTuple):
    """Footprints of N Gaussians, summed over views of C channels."""

    views: Tensor  # (N,) number of views in which it is visible
    weight: Tensor  # (N,) px
    difference: Tensor  # (N, C) image values × px

    @classmethod
    def none(cls, means: Tensor, channels: int) -> Evidence:
        """Evidence of no view, for Gaussians with these means (N, 3)."""
        n = len(means)
        return cls(means.new_zeros(n), means.new_zeros(n), means.new_zeros(n, channels))

    def add(self, view: Footprints) -> None:
        """Add a view."""
        self.views.add_(view.visible.to(self.views))
        self.weight.add_(view.weight)
        self.difference.add_(view.difference)

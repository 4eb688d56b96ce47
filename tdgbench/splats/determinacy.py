"""How well the training views determine each pixel of a render; where they do not, a model guesses.

A Gaussian's colour is taken for a linear function of the direction d that it is seen from, c(d) = xᵀ β with
x = T (1, d). Each training view measures one value of it with the weight s = min(footprint, 1 px), and the prior
variance of each of the four β is that of one measurement: colours from directions at an angle θ have a covariance
T² (1 + cos θ). Then the variance of c(d), in units of that of a measurement, is the leverage
h(d) = xᵀ (I + Σ_views s x xᵀ)⁻¹ x, and the determinacy is exp(−h). It is low for a Gaussian that few views see, and
from directions beyond those of its views, the more so the smaller the angles between these are. Pixels blend it as
colour; where nothing is rendered, it is 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import torch
from torch import Tensor

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.render import footprint_sums, render_view
from tdgbench.splats.view import CameraLike, GaussianTensors, Pinhole

T = 2.0  # standard deviation of a colour's mean, and of its change over a radian, × that of a measurement
AT_ONCE = 8192  # Gaussians in double precision: all of them would take more memory than a training
ROWS, COLUMNS = torch.triu_indices(4, 4)  # what is kept of a symmetric matrix
PLACES = torch.zeros(4, 4, dtype=torch.int64)  # in what is kept
PLACES[ROWS, COLUMNS] = PLACES[COLUMNS, ROWS] = torch.arange(len(ROWS))
ONE_VIEW = math.exp(-2 * T**2 / (1 + 2 * T**2))  # 0.41: of a Gaussian that one view sees, from the place of that view


class Determinacy:
    """The determinacy of renders of some Gaussians, whose footprints in all training views the constructor finds."""

    @torch.no_grad()
    def __init__(self, gaussians: GaussianTensors, cameras: Iterable[CameraLike], backend: str = "auto") -> None:
        """gaussians: colours are not used. cameras: of the training views."""
        self.gaussians, self.backend = gaussians, backend
        means = gaussians.means
        information = (ROWS == COLUMNS).to(means).repeat(len(means), 1)
        footprints = footprint_sums(gaussians, 1, backend)
        for camera in cameras:
            pinhole = Pinhole.of(camera).to(means)
            sums, _ = footprints(pinhole, means.new_ones(pinhole.height, pinhole.width, 1))
            for seen in sums[:, 0].nonzero().squeeze(1).split(AT_ONCE):
                x = _terms(pinhole, means[seen])
                weighted = sums[seen].clamp(max=1) * x
                information.index_add_(0, seen, (weighted[:, ROWS] * x[:, COLUMNS]).to(information))
        for some in information.split(AT_ONCE):
            some.copy_(torch.linalg.inv(some.double()[:, PLACES])[:, ROWS, COLUMNS])
        self.covariance = information  # (N, 10)

    @classmethod
    def of_model(cls, gaussians: Gaussians, cameras: Iterable[CameraLike]) -> Determinacy:
        """Return that of a model as its PLY file has it: without filters, deformations and the thermal camera's rig."""
        return cls(gaussians.activated(0), cameras)

    @torch.no_grad()
    def of_gaussians(self, camera: Pinhole) -> Tensor:
        """Return the determinacy (N,) of each Gaussian as a camera sees it, in [0, 1]."""
        leverages = []
        for means, covariance in zip(self.gaussians.means.split(AT_ONCE), self.covariance.split(AT_ONCE), strict=True):
            x = _terms(camera, means)
            leverages.append(torch.einsum("ni,nij,nj->n", x, covariance.double()[:, PLACES], x).to(means))
        return torch.exp(-torch.cat(leverages))

    @torch.no_grad()
    def image(self, camera: CameraLike) -> Tensor:
        """Return the determinacy (H, W) of a render's pixels, in [0, 1], on the CPU."""
        pinhole = Pinhole.of(camera).to(self.gaussians.means)
        coloured = self.gaussians._replace(colors=self.of_gaussians(pinhole)[:, None], sh_degree=None)
        return render_view(coloured, pinhole, backend=self.backend).image[..., 0].cpu()


def _terms(camera: Pinhole, means: Tensor) -> Tensor:
    """Return x (n, 4), in double precision, of the directions from a camera to some means (n, 3)."""
    rays = means.double() @ camera.viewmat[:3, :3].double().T + camera.viewmat[:3, 3].double()
    directions = torch.nn.functional.normalize(rays, dim=1) @ camera.viewmat[:3, :3].double()
    return T * torch.cat([torch.ones_like(directions[:, :1]), directions], dim=1)

"""The rig: pose and lens of the thermal camera relative to the scene's poses, learnt with the Gaussians.

In most RGB-thermal captures the poses are those of the RGB camera. All thermal views share the rig; test views get it
without being read.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import Hook
from tdgbench.splats.geometry import to_camera_space
from tdgbench.splats.view import GaussianTensors, Pinhole
from tdgbench.training.part import Part, Report, State

NUMBERS = {"turn": 3, "shift": 3, "focal": 1, "center": 2, "distortion": 2}
RATES = {"turn": 1.0, "shift": 1.0, "focal": 1.0, "center": 1.0, "distortion": 20.0}  # × the learning rate
RATE = 2e-4  # radians, shares of the scene's extent, shares of the focal length
BEYOND = 1.5  # times the radius of the image's corners, up to which distortion grows


class Rig(Part):
    """Eleven numbers that all thermal views share, with their optimiser; all are 0 at first.

    turn: rotation vector, radians, in the camera's axes (x right, y down, z forward). shift: of the points in these
    axes, shares of the scene's extent. focal: its change, as a share. center: shift of the principal point, shares of
    the focal length. distortion: k1, k2; distorted = (1 + k1 r² + k2 r⁴) × undistorted, as in OpenCV.
    """

    needed_to_render = True

    def __init__(self, extent: float, device: torch.device) -> None:
        """extent: of the scene, world units."""
        self.extent = extent
        self.numbers = {name: torch.zeros(count, requires_grad=True, device=device) for name, count in NUMBERS.items()}
        groups = [{"params": [number], "lr": RATE * RATES[name]} for name, number in self.numbers.items()]
        self.optimizer = torch.optim.Adam(groups)

    def step(self, iteration: int) -> str | None:
        gradients = {name: number.grad for name, number in self.numbers.items() if number.grad is not None}
        bad = self.not_finite() or next((name for name, grad in gradients.items() if not grad.isfinite().all()), None)
        if bad is None:
            self.optimizer.step()
        self.optimizer.zero_grad()
        return bad

    def set_slowdown(self, factor: float) -> None:
        for name, group in zip(NUMBERS, self.optimizer.param_groups, strict=True):
            group["lr"] = factor * RATE * RATES[name]

    def not_finite(self) -> str | None:
        return next((name for name, number in self.numbers.items() if not number.isfinite().all()), None)

    def state_dict(self) -> State:
        return {
            "numbers": {name: number.detach() for name, number in self.numbers.items()},
            "adam": self.optimizer.state_dict(),
        }

    def load_state_dict(self, saved: State) -> None:
        for name, number in self.numbers.items():
            number.data.copy_(saved["numbers"][name])
        self.optimizer.load_state_dict(saved["adam"])

    def report(self) -> Report:
        """Return degrees, world units, and shares."""
        estimates = {name: number.detach().cpu().double() for name, number in self.numbers.items()}
        estimates["turn"], estimates["shift"] = estimates["turn"].rad2deg(), self.extent * estimates["shift"]
        return {name: [round(value, 6) for value in number.tolist()] for name, number in estimates.items()}

    def camera(self, given: Camera) -> Camera:
        """Return the thermal camera beside a given one, without its distortion."""
        with torch.no_grad():
            viewmat, K = self._pinhole(Pinhole.of(given).to(self.numbers["turn"]))
        pose = np.eye(4)  # exactly rigid
        pose[:3] = viewmat[:3].cpu().double().numpy()
        return Camera(K.cpu().double().numpy(), pose, given.width, given.height)

    def through(self, hook: Hook | None, given: Pinhole) -> tuple[Hook, Pinhole]:
        """Return the hook and the camera that render what the thermal camera beside a given one sees."""
        given = given.to(self.numbers["turn"])
        viewmat, K = self._pinhole(given)

        def seen(gaussians: Gaussians, degree: int) -> GaussianTensors:
            active = (hook or Gaussians.activated)(gaussians, degree)
            return self._lens(to_camera_space(active, viewmat), K, given)

        return seen, given._replace(viewmat=torch.eye(4).to(viewmat), K=K.detach())

    def _pinhole(self, given: Pinhole) -> tuple[Tensor, Tensor]:
        """Return pose (4, 4) and K (3, 3), with gradients."""
        x, y, z = self.numbers["turn"]
        zero = torch.zeros_like(x)
        rigid = torch.eye(4).to(x)
        rigid[:3, :3] = torch.matrix_exp(torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3))
        rigid[:3, 3] = self.extent * self.numbers["shift"]
        scale = torch.diag(torch.cat([(1 + self.numbers["focal"]).expand(2), torch.ones(1).to(x)]))
        K = given.K @ scale
        moved = torch.zeros_like(K)
        moved[:2, 2] = self.numbers["center"] * torch.stack([given.K[0, 0], given.K[1, 1]])
        return rigid @ given.viewmat, K + moved

    def _lens(self, seen: GaussianTensors, K: Tensor, given: Pinhole) -> GaussianTensors:
        """Distort the means. They also carry the gradients of K, since the renderer takes K without gradient."""
        x, y, z = seen.means.unbind(-1)
        focal, center = K[0, 0] / K[0, 0].detach(), (K[:2, 2] - K[:2, 2].detach()) / torch.stack([K[0, 0], K[1, 1]])
        corner = float(torch.linalg.norm(torch.tensor([given.width / given.K[0, 0], given.height / given.K[1, 1]]))) / 2
        depth = z.clamp_min(given.near_plane)
        r2 = ((x * x + y * y) / (depth * depth)).clamp_max((BEYOND * corner) ** 2)
        k1, k2 = self.numbers["distortion"]
        factor = focal * (1 + k1 * r2 + k2 * r2 * r2)
        means = torch.stack([x * factor + center[0] * z, y * factor + center[1] * z, z], dim=-1)
        return seen._replace(means=means, scales=seen.scales * focal)

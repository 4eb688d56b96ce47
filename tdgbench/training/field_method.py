"""What methods of radiance fields share: a placed field, its renders of rays and images, and the time of its steps."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import torch
from pydantic import Field, PositiveInt
from torch import Tensor, nn

from tdgbench.fields import DensityField, Rays, Region, image_rays, rays_of, region_of
from tdgbench.scenes import Camera, Scene
from tdgbench.splats.view import Pinhole, Render
from tdgbench.training.budget import Budget, FieldSize
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Method
from tdgbench.training.part import Network, Report, State
from tdgbench.training.warmup import compile_field_kernels

FEATURES = 15  # of the density network, for the heads; geo_feat_dim of nerfacto, network.py of torch-ngp
DIRECTIONS = 16  # harmonics up to degree 3
TIMED = 4096  # positions
CoarsestAndFinest = Annotated[list[PositiveInt], Field(min_length=2, max_length=2)]  # level of a hash grid


@dataclass
class Rendered:
    """What R rays show, by modality."""

    images: dict[str, Tensor]  # (R, C)
    depth: Tensor  # (R,) accumulated z
    transmittance: Tensor  # (R,) share of the light from behind all samples


class PlacedField(nn.Module):
    """A field with the region that it represents, which is stored: stored cells have no points."""

    density: DensityField
    region_numbers: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("region_numbers", torch.zeros(7, dtype=torch.float64))

    @property
    def region(self) -> Region:
        x, y, z, radius, near, far, is_cube = self.region_numbers.tolist()
        return Region((x, y, z), radius, near, far, bool(is_cube))

    @region.setter
    def region(self, region: Region) -> None:
        self.region_numbers.copy_(torch.tensor([*region.center, *region[1:]], dtype=torch.float64))

    @property
    def is_placed(self) -> bool:
        """Whether the region is known."""
        return self.region.radius > 0

    def check_place(self) -> None:
        """Raise ValueError for the region of a broken file."""
        region = self.region
        is_finite = bool(self.region_numbers.isfinite().all())
        if not (is_finite and self.is_placed and 0 < region.near < region.far):
            raise ValueError(f"its region of the world is none: {region}")


class FieldNetwork(Network):
    """A field with its optimiser; it reports where the field is placed."""

    module: PlacedField

    def load_rendering_state(self, saved: State) -> None:
        super().load_rendering_state(saved)
        self.module.check_place()

    def report(self) -> Report:
        if not self.module.is_placed:
            return super().report()
        region = self.module.region
        place: Report = {"center": [*region.center], "unit": region.radius, "near": region.near, "far": region.far}
        return {**super().report(), **place}


class FieldMethod(Method):
    """A method whose `field` renders rays: its kernels, its place, its images.

    A subclass implements `rendered` and `values_at`, and calls `begin_field` in its set-up.
    """

    renders_plain_gaussians = False
    keeps_all_points = True
    can_learn_rig = False
    keeps_full_resolution = True
    pixels_of_check = 1024  # an image takes as long as some ten steps
    rays_at_once: int = 4096  # of an image, which are rendered together
    region_is_cube = False  # else a ball

    field: Any  # a PlacedField
    has_measured_points: bool  # else those that place it are random
    size: FieldSize

    def rendered(self, rays: Rays, modality: str) -> Rendered:
        """Return what rays show of a modality, without jitter."""
        raise NotImplementedError

    def values_at(self, positions: Tensor) -> Tensor:
        """Return the sum of what the field computes at contracted positions (N, 3), to measure its time."""
        raise NotImplementedError

    @property
    def samples_of_step(self) -> int:
        """The number of positions at which a step evaluates the field, about."""
        return self.size.rays * self.size.samples[-1]

    def compile_kernels(self, scene: Scene, budget: Budget, backend: str) -> None:
        compile_field_kernels(backend)

    def begin_field(self, context: Context) -> FieldSize:
        """Note the size of the field, and what it is placed by; return the size. Raises ValueError if there is none.

        It is placed by the initial points, or by the scene's where these are random.
        """
        if context.budget.field is None:
            raise ValueError("the budget lacks `field`, the size of a radiance field; see conf/budget/paper.yaml")
        if context.budget.gaussians is not None:
            raise ValueError(
                f"a radiance field has no Gaussians: leave out budget.gaussians={context.budget.gaussians}"
            )
        self.size = context.budget.field
        cloud, known = context.points, context.scene.points
        if not cloud.is_measured and known is not None and len(known.points):
            cloud = known
        self._points, self.has_measured_points = cloud.points, cloud.is_measured
        self._cameras = [view.camera for view in context.scene.train]
        return self.size

    def place(self) -> None:
        """Find the field's region, unless it is known: not in the set-up, which stored cells have without points."""
        if not self.field.is_placed:
            poses = np.stack([camera.world_to_camera for camera in self._cameras])
            self.place_in(region_of(self._points, poses, self.region_is_cube), self._points, self._cameras)

    def place_in(self, region: Region, points: np.ndarray, cameras: Sequence[Camera]) -> None:
        """Place the field, given the region of the scene, with its points (N, 3) and training cameras."""
        self.field.region = region

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        camera = Pinhole.of(frame.camera).to(self.field.density.grid.table)
        rays, parts = image_rays(camera.K, camera.viewmat, camera.width, camera.height), list[Rendered]()
        for start in range(0, len(rays.origins), self.rays_at_once):
            piece = Rays(*(tensor[start : start + self.rays_at_once] for tensor in rays))
            parts.append(self.rendered(piece, modality))
        size = camera.height, camera.width
        image = torch.cat([part.images[modality] for part in parts]).clamp(0, 1).view(*size, -1)
        depth, transmittance = (
            torch.cat(columns).view(size) for columns in ([p.depth for p in parts], [p.transmittance for p in parts])
        )
        return Render(image, depth, transmittance)

    @torch.no_grad()
    def render_pixels(self, frame: Frame, pixels: Tensor, modality: str) -> Tensor:
        camera = Pinhole.of(frame.camera).to(self.field.density.grid.table)
        rays = rays_of(pixels.to(camera.K), camera.K, camera.viewmat)
        return self.rendered(rays, modality).images[modality].clamp(0, 1)

    def step_seconds(self) -> float:
        """Return the time of the field; that of sampling comes on top."""
        positions = torch.rand(TIMED, 3).to(self.field.density.grid.table)
        seconds = min(self._seconds_at(positions) for _ in range(3))  # the first time, memory is new
        return seconds * self.samples_of_step / TIMED

    def _seconds_at(self, positions: Tensor) -> float:
        start = time.perf_counter()
        self.values_at(positions).backward()
        self.field.zero_grad()
        return time.perf_counter() - start

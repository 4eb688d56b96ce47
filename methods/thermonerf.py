"""ThermoNeRF (Hassan et al. 2024): a radiance field with one density and heads for colour and temperature.

The field is nerfacto's (Tancik et al. 2023): proposal networks, a hash grid, and a network of direction for colour.
The thermal head has no direction and no appearance.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt
from torch import Tensor, nn
from torch.nn import functional

from methods.deformable import falling
from tdgbench.fields import (
    MLP,
    DensityField,
    FieldAdam,
    GridOptions,
    Rays,
    Region,
    Sampler,
    annealed,
    distortion_loss,
    encoded_directions,
    image_rays,
    proposal_loss,
    region_of,
)
from tdgbench.fields.proposals import Proposed, Samples
from tdgbench.fields.volume import composited
from tdgbench.scenes import Scene
from tdgbench.splats.view import Pinhole, Render
from tdgbench.training.budget import Budget
from tdgbench.training.context import Context
from tdgbench.training.method import Frame, Method, Share, Step
from tdgbench.training.part import Network
from tdgbench.training.warmup import compile_field_kernels

FEATURES = 15  # of the density network, for the heads; geo_feat_dim
DIRECTIONS = 16  # harmonics up to degree 3
PIECE = 4096  # rays of an image that are rendered together
TIMED = 4096  # positions


class Rendered(NamedTuple):
    """What R rays show, by modality, with the samples that it was made of.

    The last sample of a ray hides what is behind it, in images (thermal_renderer.py) as in depth.
    """

    images: dict[str, Tensor]  # (R, C)
    depth: Tensor  # (R,) z
    weights: Tensor  # (R, S), without that
    samples: Samples
    proposed: list[Proposed]


class ThermalHead(nn.Module):
    """Temperatures of features: `width` sigmoids after two layers, then a linear one, unbounded (thermal_field.py)."""

    def __init__(self, width: int, channels: int, generator: torch.Generator) -> None:
        super().__init__()
        self.layers = MLP((FEATURES, width, width), generator, sigmoid=True)
        self.last = nn.Linear(width, channels)
        for parameter in self.last.parameters():  # as torch starts them, but by the generator
            nn.init.uniform_(parameter, -(width**-0.5), width**-0.5, generator=generator)

    def forward(self, features: Tensor) -> Tensor:
        """Return temperatures (N, C) of features (N, FEATURES)."""
        temperatures: Tensor = self.last(self.layers(features))
        return temperatures


class ColourHead(nn.Module):
    """RGB of features, direction and appearance of a view; without a view, the mean appearance."""

    def __init__(self, width: int, appearance: int, views: int, generator: torch.Generator) -> None:
        super().__init__()
        self.network = MLP((DIRECTIONS + FEATURES + appearance, width, width, 3), generator, sigmoid=True)
        self.appearances = nn.Parameter(torch.randn(views, appearance, generator=generator))

    def forward(self, features: Tensor, directions: Tensor, views: Tensor | None) -> Tensor:
        """Return colours (R · S, 3) of features (R · S, FEATURES), S samples of R rays with directions (R, 3)."""
        mean = self.appearances.mean(dim=0)
        appearance = mean.expand(len(directions), -1) if views is None else self.appearances[views]
        of_rays = torch.cat([encoded_directions(directions), appearance], dim=1)
        of_samples = of_rays.repeat_interleave(len(features) // len(directions), dim=0)
        colours: Tensor = self.network(torch.cat([of_samples, features], dim=1))
        return colours


class ThermalField(nn.Module):
    """Sampler, density, heads, and the region that they represent, which is stored: stored cells have no points."""

    region_numbers: Tensor

    def __init__(
        self, sampler: Sampler, density: DensityField, thermal: ThermalHead, colour: ColourHead | None
    ) -> None:
        super().__init__()
        self.sampler, self.density, self.thermal, self.colour = sampler, density, thermal, colour
        self.register_buffer("region_numbers", torch.zeros(6, dtype=torch.float64))

    @property
    def region(self) -> Region:
        x, y, z, radius, near, far = self.region_numbers.tolist()
        return Region((x, y, z), radius, near, far)

    @region.setter
    def region(self, region: Region) -> None:
        self.region_numbers.copy_(torch.tensor([*region.center, *region[1:]], dtype=torch.float64))

    @property
    def is_placed(self) -> bool:
        """Whether the region is known."""
        return self.region.radius > 0

    def forward(
        self, rays: Rays, modalities: tuple[str, ...], views: Tensor | None = None,
        generator: torch.Generator | None = None, annealing: float = 1.0, learns: bool = False,
    ) -> Rendered:  # fmt: skip
        """Render rays. views (R,): whose appearance they have. The others: of the sampler."""
        samples, proposed = self.sampler(rays, self.region, generator, annealing, learns)
        densities, features = self.density(samples.contracted)
        weights, images = samples.weights(densities), {}
        before = weights[:, :-1]
        shares = torch.cat([before, 1 - before.sum(dim=1, keepdim=True)], dim=1)
        for modality in modalities:
            if modality == "rgb" and self.colour is not None:
                values = self.colour(features, rays.directions, views)
            else:
                values = self.thermal(features)
            images[modality] = composited(shares, values.view(*weights.shape, -1))
        depth = composited(shares, samples.depths[..., None]).squeeze(1)
        return Rendered(images, depth, weights, samples, proposed)


@dataclass
class ThermoNeRF(Method):
    """L = L_rgb + λ_thermal L_thermal + λ_interlevel L_interlevel + λ_distortion L_distortion, the first two MSEs."""

    renders_plain_gaussians = False

    rgb: bool  # whether RGB images are trained on, too
    lambda_thermal: NonNegativeFloat
    lambda_interlevel: NonNegativeFloat
    lambda_distortion: NonNegativeFloat
    rates: list[PositiveFloat]  # first and last; they fall log-linearly
    rate_end: PositiveFloat  # where the last one is reached, as a multiple of all iterations
    levels: PositiveInt
    cells: list[PositiveInt]  # of the coarsest and the finest level, along an axis
    width: PositiveInt  # of the networks
    initial_density: PositiveFloat  # per radius of the region
    appearance: PositiveInt  # numbers of a view
    proposal_levels: PositiveInt
    proposal_finest: list[PositiveInt]  # by proposal network; the last ones, where the budget has fewer
    proposal_width: PositiveInt
    proposal_log2_rows: PositiveInt  # or the budget's, if smaller
    proposal_every: PositiveInt  # iterations between steps of the proposals
    proposal_warm_up: Share  # of all iterations, over which these become so many
    annealing_end: Share  # of all iterations

    def __post_init__(self) -> None:
        self.modalities = ("thermal", "rgb") if self.rgb else ("thermal",)

    def compile_kernels(self, scene: Scene, budget: Budget, backend: str) -> None:
        compile_field_kernels(backend)

    def setup(self, context: Context) -> None:
        size = context.budget.field
        if size is None:
            raise ValueError("the budget lacks `field`, the size of a radiance field; see conf/budget/paper.yaml")
        if len(size.samples) > 1 + len(self.proposal_finest):
            raise ValueError(f"budget.field.samples names {len(size.samples) - 1} proposals, the method has fewer")
        generator, scene = torch.Generator().manual_seed(context.seed), context.scene
        grid = partial(GridOptions, coarsest=self.cells[0], initial_density=self.initial_density)
        rows, first = min(self.proposal_log2_rows, size.log2_rows), 1 + len(self.proposal_finest) - len(size.samples)
        small = partial(grid, levels=self.proposal_levels, log2_rows=rows, hidden=self.proposal_width)
        proposals = [DensityField(small(finest=finest), 0, generator) for finest in self.proposal_finest[first:]]
        options = grid(levels=self.levels, finest=self.cells[1], log2_rows=size.log2_rows, hidden=self.width)
        density = DensityField(options, FEATURES, generator)
        thermal = ThermalHead(self.width, scene.channels, generator)
        colour = ColourHead(self.width, self.appearance, len(scene.train), generator) if self.rgb else None
        module = ThermalField(Sampler(proposals, size.samples), density, thermal, colour).to(context.device)
        self.iterations, self.size = context.budget.schedule_length, size
        rate = falling(self.rates, max(1, round(self.rate_end * self.iterations)))
        context.add_part("field", Network(module, rate, FieldAdam))
        self.field = module
        self.batches = context.rays(self.modalities)
        self.jitter = context.random("jitter")
        self.points, self.poses = context.points.points, np.stack([v.camera.world_to_camera for v in scene.train])

    def step(self, iteration: int) -> Step:
        if not self.field.is_placed:
            self.field.region = region_of(self.points, self.poses)
        batch = self.batches.next(self.size.rays)
        annealing = annealed(iteration / max(self.annealing_end * self.iterations, 1))
        learns = self._proposals_learn(iteration)
        shown = self.field(batch.rays, self.modalities, batch.views, self.jitter, annealing, learns)
        terms = {name: functional.mse_loss(image, batch.pixels[name]) for name, image in shown.images.items()}
        loss = self.lambda_thermal * terms["thermal"] + terms.get("rgb", 0.0)
        if self.lambda_distortion > 0:
            terms["distortion"] = distortion_loss(shown.samples.places, shown.weights)
            loss = loss + self.lambda_distortion * terms["distortion"]
        if learns and shown.proposed:
            loss = loss + self.lambda_interlevel * proposal_loss(shown.samples, shown.weights, shown.proposed)
        image = shown.images["thermal"][:, None]  # a column of pixels
        render = Render(image, None, torch.zeros_like(shown.depth)[:, None])
        return Step(loss, terms, render, batch.pixels["thermal"][:, None])

    @torch.no_grad()
    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        camera = Pinhole.of(frame.camera).to(self.field.density.grid.table)
        rays, parts = image_rays(camera.K, camera.viewmat, camera.width, camera.height), list[Rendered]()
        for start in range(0, len(rays.origins), PIECE):
            piece = Rays(*(tensor[start : start + PIECE] for tensor in rays))
            parts.append(self.field(piece, (modality,)))
        size = camera.height, camera.width
        image = torch.cat([part.images[modality] for part in parts]).clamp(0, 1).view(*size, -1)
        depth = torch.cat([part.depth for part in parts]).view(size)
        return Render(image, depth, torch.zeros_like(depth))

    def step_seconds(self) -> float:
        """Return the time of the field; that of the proposals comes on top."""
        positions = torch.rand(TIMED, 3).to(self.field.density.grid.table)
        seconds = [self._seconds_at(positions) for _ in range(2)]  # the first time, memory is new
        return seconds[1] * self.size.rays * self.size.samples[-1] / TIMED

    def _seconds_at(self, positions: Tensor) -> float:
        start = time.perf_counter()
        densities, features = self.field.density(positions)
        (densities.sum() + self.field.thermal(features).sum()).backward()
        self.field.zero_grad()
        return time.perf_counter() - start

    def _proposals_learn(self, iteration: int) -> bool:
        """Return whether the proposals make a step: always at first, then in ever fewer iterations (nerfacto)."""
        progress = iteration / max(self.proposal_warm_up * self.iterations, 1)
        return iteration % max(1, round(self.proposal_every * min(progress, 1.0))) == 0

"""ThermoNeRF (Hassan et al. 2024): a radiance field with one density and heads for colour and temperature.

The field is nerfacto's (Tancik et al. 2023): proposal networks, a hash grid, and a network of direction for colour.
The thermal head has no direction and no appearance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

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
    Sampler,
    annealed,
    distortion_loss,
    encoded_directions,
    proposal_loss,
)
from tdgbench.fields.proposals import Proposed, Samples
from tdgbench.fields.sampling import DisparitySpacing
from tdgbench.fields.volume import composited
from tdgbench.scenes import View
from tdgbench.splats.view import Render
from tdgbench.training.context import Context
from tdgbench.training.field_method import (
    DIRECTIONS,
    FEATURES,
    CoarsestAndFinest,
    FieldMethod,
    FieldNetwork,
    PlacedField,
    Rendered,
)
from tdgbench.training.method import FirstAndLast, Share, Step
from tdgbench.training.part import Part
from tdgbench.training.rays import RayBatch

NERFACTO_EXTENT = DisparitySpacing(0.05, 1000.0, 1.0).extent  # of its samples, near to far, in its distortion loss
ALWAYS = 10  # first iterations in which proposals make a step: nerfstudio, ray_samplers.py


@dataclass
class Sampled(Rendered):
    """What rays show, with the samples that it was made of.

    The last sample of a ray hides what is behind it, in images (thermal_renderer.py) as in depth.
    """

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


class ThermalField(PlacedField):
    """Sampler, density and heads."""

    def __init__(
        self, sampler: Sampler, density: DensityField, thermal: ThermalHead, colour: ColourHead | None
    ) -> None:
        super().__init__()
        self.sampler, self.density, self.thermal, self.colour = sampler, density, thermal, colour

    def forward(
        self, rays: Rays, modalities: tuple[str, ...], views: Tensor | None = None,
        generator: torch.Generator | None = None, annealing: float = 1.0, learns: bool = False,
    ) -> Sampled:  # fmt: skip
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
        return Sampled(images, depth, torch.zeros_like(depth), weights, samples, proposed)


class ProposalTurns(Part):
    """Says in which iterations the proposals make a step: ever fewer (nerfstudio's ProposalNetworkSampler).

    The number of iterations since the last one, which counts it, must exceed a threshold, which rises from 1.
    """

    changing = ("since",)

    def __init__(self, every: int, warm_up: float) -> None:
        """every: the last threshold. warm_up: iterations, in which it is reached."""
        self.every, self.warm_up, self.since = every, warm_up, 0

    def takes(self, iteration: int) -> bool:
        """Return whether an iteration, each in turn, is one; the first ones are."""
        before = max(iteration - 2, 0)  # the number, from 0, of the iteration before
        threshold = max(1.0, self.every * min(before / max(self.warm_up, 1.0), 1.0))
        is_one = self.since > threshold or before < ALWAYS
        self.since = 1 if is_one else self.since + 1
        return is_one


@dataclass
class ThermoNeRF(FieldMethod):
    """L = L_rgb + λ_thermal L_thermal + λ_interlevel L_interlevel + λ_distortion L_distortion, the first two MSEs."""

    region_is_cube = True  # thermal_dataparser.py scales the largest absolute coordinate of a camera to 1

    rgb: bool  # whether RGB images are trained on, too
    lambda_thermal: NonNegativeFloat
    lambda_interlevel: NonNegativeFloat
    lambda_distortion: NonNegativeFloat
    rates: FirstAndLast  # first and last; they fall log-linearly
    rate_end: PositiveFloat  # where the last one is reached, as a multiple of all iterations
    levels: PositiveInt
    cells: CoarsestAndFinest  # of the coarsest and the finest level, along an axis
    width: PositiveInt  # of the networks
    initial_density: PositiveFloat  # per radius of the region
    appearance: PositiveInt  # numbers of a view
    proposal_levels: PositiveInt
    proposal_finest: list[PositiveInt]  # by proposal network; the last ones, where the budget has fewer
    proposal_width: PositiveInt
    proposal_log2_rows: PositiveInt  # or the budget's, if smaller
    proposal_every: PositiveInt  # iterations that pass between steps of the proposals
    proposal_warm_up: Share  # of all iterations, over which these become so many
    annealing_end: Share  # of all iterations

    def __post_init__(self) -> None:
        self.modalities = ("thermal", "rgb") if self.rgb else ("thermal",)

    def setup(self, context: Context) -> None:
        size = self.begin_field(context)
        if len(size.samples) > 1 + len(self.proposal_finest):
            known = f"method.method.proposal_finest has {len(self.proposal_finest)}"
            raise ValueError(f"budget.field.samples names {len(size.samples) - 1} proposals, {known}")
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
        self.iterations = context.budget.schedule_length
        rate = falling(self.rates, max(1, round(self.rate_end * self.iterations)))
        context.add_part("field", FieldNetwork(module, rate, FieldAdam))
        self.field = module
        self.batches = context.rays(self.modalities, maps=self.maps(context))
        self.jitter = context.random("jitter")
        turns = ProposalTurns(self.proposal_every, self.proposal_warm_up * self.iterations)
        self.turns = context.add_part("proposal_turns", turns)

    def step(self, iteration: int) -> Step:
        self.place()
        batch = self.batches.next(self.size.rays)
        annealing = annealed(iteration / max(self.annealing_end * self.iterations, 1))
        learns = self.turns.takes(iteration)
        shown = self.field(batch.rays, self.modalities, batch.views, self.jitter, annealing, learns)
        terms = {name: functional.mse_loss(image, batch.pixels[name]) for name, image in shown.images.items()}
        loss = self.lambda_thermal * terms["thermal"] + terms.get("rgb", 0.0)
        if self.lambda_distortion > 0:
            share = shown.samples.extent / NERFACTO_EXTENT
            terms["distortion"] = share * distortion_loss(shown.samples.places, shown.weights)
            loss = loss + self.lambda_distortion * terms["distortion"]
        if learns and shown.proposed:
            loss = loss + self.lambda_interlevel * proposal_loss(shown.samples, shown.weights, shown.proposed)
        for name, term in self.further_losses(batch, shown).items():
            terms[name] = term
            loss = loss + term
        image = shown.images["thermal"][:, None]  # a column of pixels
        render = Render(image, None, shown.transmittance[:, None])
        return Step(loss, terms, render, batch.pixels["thermal"][:, None])

    def maps(self, context: Context) -> dict[str, Callable[[View], Tensor]]:
        """Return what batches bring of pixels beside their modalities; nothing by default."""
        return {}

    def further_losses(self, batch: RayBatch, shown: Sampled) -> dict[str, Tensor]:
        """Return weighted terms that a subclass adds to the loss."""
        return {}

    def rendered(self, rays: Rays, modality: str) -> Rendered:
        shown: Rendered = self.field(rays, (modality,))
        return shown

    def values_at(self, positions: Tensor) -> Tensor:
        """Return the sum of density and temperatures; the time of the proposals comes on top."""
        densities, features = self.field.density(positions)
        return densities.sum() + self.field.thermal(features).sum()

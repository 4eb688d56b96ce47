"""Four ways to learn temperatures with an instant-ngp field (Özer et al. 2024, whose data are ThermalMix).

The field is torch-ngp's: a hash grid, networks without biases, an occupancy grid, white behind everything. Constants
and order: mert-o/ThermalNeRFs, commit d822bd10.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import torch
from pydantic import Field, PositiveFloat, PositiveInt
from torch import Tensor, nn

from methods.deformable import falling
from tdgbench.fields import (
    MLP,
    DensityField,
    FieldAdam,
    GridOptions,
    OccupancyGrid,
    Rays,
    Region,
    encoded_directions,
    march,
    visible_cells,
)
from tdgbench.fields.volume import composited, transmittance_of, weights_of
from tdgbench.scenes import Camera, TemperatureRange
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
from tdgbench.training.method import FirstAndLast, Share, Stage, Step
from tdgbench.training.part import Part, Rate, Report, State

FULL_UPDATES = 16  # of all cells of the occupancy grid; then half of them: renderer.py, `update_extra_state`
POINTS_OF_RAY = 64  # 2^18 points of a step with 4 096 rays at first: main.py, num_points and num_rays
MOST_RAYS = 4  # × those of the budget


class Output(NamedTuple):
    """Which numbers of which head are the image of a modality, and how it is made of samples."""

    head: str
    first: int
    end: int
    is_white_behind: bool = True  # else 0 °C
    moves_density: bool = True  # whether the image's gradient reaches the densities


@dataclass
class Marching(Rendered):
    """What rays show, with the number of samples that it was made of."""

    points: int


class InstantField(PlacedField):
    """Density, an occupancy grid, and heads with a direction, sigmoids of 15 features and 16 harmonics (network.py)."""

    zero: Tensor

    def __init__(self, density: DensityField, occupancy: OccupancyGrid, heads: Mapping[str, MLP], steps: int) -> None:
        """steps: samples of a ray, before those in empty cells are left out."""
        super().__init__()
        self.density, self.occupancy, self.heads, self.steps = density, occupancy, nn.ModuleDict(heads), steps
        self.register_buffer("zero", torch.zeros(()))  # image value of 0 °C; stored cells have no range of °C

    def forward(self, rays: Rays, outputs: Mapping[str, Output], generator: torch.Generator | None = None) -> Marching:
        """Render rays by modality. generator: of jitter; None: none."""
        marched = march(rays, self.region, self.occupancy, self.steps, generator)
        densities, features = self.density(marched.contracted)
        weights = weights_of(marched.table(densities[:, None]).squeeze(2), marched.lengths)
        inputs = torch.cat([features, encoded_directions(rays.directions)[marched.rays]], dim=1)
        values = {name: self.heads[name](inputs) for name in {output.head for output in outputs.values()}}
        images = {}
        for modality, output in outputs.items():
            value = values[output.head][:, output.first : output.end]
            if modality == "thermal":  # the sigmoid is of temperatures from 0 °C on
                value = self.zero + (1 - self.zero) * value
            table = marched.table(value)
            behind = table.new_ones(table.shape[2]) if output.is_white_behind else self.zero.expand(table.shape[2])
            images[modality] = composited(weights if output.moves_density else weights.detach(), table, behind)
        depth = composited(weights, marched.depths[..., None]).squeeze(1)
        return Marching(images, depth, transmittance_of(weights), len(marched.contracted))


class RayCount(Part):
    """How many rays a step has, so that all of them have about as many occupied samples (`adaptive_num_rays`)."""

    changing = ("rays",)

    def __init__(self, rays: int) -> None:
        """rays: of the first step."""
        self.points, self.most, self.rays = POINTS_OF_RAY * rays, MOST_RAYS * rays, rays

    def report(self) -> Report:
        return {"rays": self.rays}

    def note(self, points: int) -> None:
        """Take the number of samples of a step, and choose the rays of the next one."""
        wanted = round(self.rays * self.points / max(points, 1))
        self.rays = min(max(wanted, 1), self.most)


class AveragedNetwork(FieldNetwork):
    """A field with its optimiser, and a moving average of its weights, which renders (torch_ema, after each epoch).

    The average has the occupancy grid and the region of the field itself.
    """

    before = 0  # iterations of the stages before this one
    module: InstantField

    def __init__(self, field: InstantField, rate: Rate, factor: float, planned: int, iterations: int) -> None:
        """factor: of the average at an epoch, smaller at first. planned: epochs in the iterations of all stages."""
        super().__init__(field, rate, FieldAdam)
        self.factor, self.planned, self.iterations, self.epochs = factor, planned, iterations, 0
        self.average = copy.deepcopy(field)
        self.average.occupancy, self.average.region_numbers = field.occupancy, field.region_numbers

    def step(self, iteration: int) -> str | None:
        not_finite = super().step(iteration)
        now = self.before + iteration
        if ended := now * self.planned // self.iterations - (now - 1) * self.planned // self.iterations:
            self.epochs += ended
            factor = min(self.factor, (1 + self.epochs) / (10 + self.epochs)) ** ended
            with torch.no_grad():
                for average, latest in zip(self.average.parameters(), self.module.parameters(), strict=True):
                    average.lerp_(latest, 1 - factor)
        return not_finite

    def state_dict(self) -> State:
        weights = {name: parameter.detach() for name, parameter in self.average.named_parameters()}
        return {**super().state_dict(), "average": weights, "epochs": self.epochs}

    def load_state_dict(self, saved: State) -> None:
        super().load_state_dict(saved)
        self.average.load_state_dict(saved["module"] | saved["average"])
        self.epochs = saved["epochs"]

    def rendering_state(self) -> State:
        return {"module": dict(self.average.state_dict())}

    def load_rendering_state(self, saved: State) -> None:
        self.average.load_state_dict(saved["module"] | saved.get("average", {}))
        self.average.check_place()

    def report(self) -> Report:
        occupied = self.module.occupancy.occupied_share()
        return {**super().report(), "occupied": occupied, "zero_degC_at": float(self.module.zero)}


@dataclass
class InstantThermal(FieldMethod):
    """L = Σ w mean (image − target)² over the modalities, w = 1 but for `released_domain`; what the four share.

    A subclass sets `outputs`, by modality, and makes the field of them by `begin`.
    """

    rays_at_once = 512  # with up to a thousand samples each
    learns_degC = True  # thermal values are temperatures over the largest one, else those of the image
    thermal_weight, zero = 1.0, 0.0

    rates: FirstAndLast  # first and last; they fall log-linearly
    rate_end: Share  # of all iterations; the last rate is reached there, and stays
    levels: PositiveInt
    cells: CoarsestAndFinest  # of the coarsest and the finest level, along an axis of four units
    layers: PositiveInt  # hidden ones of the density's network
    width: PositiveInt  # of these
    head_layers: PositiveInt
    head_width: PositiveInt
    initial_density: PositiveFloat  # per unit
    steps: PositiveInt  # samples of a ray before empty cells are left out, × the budget's first number of samples
    update_every: PositiveInt  # iterations between updates of the occupancy grid
    averaging: Share  # factor of the averaged weights after an epoch
    epochs: PositiveInt  # in all iterations
    bound: PositiveFloat  # half the largest box, units
    near_percentile: Annotated[float, Field(ge=0, le=100)]  # of the depths of a view's points: it shows nothing nearer

    def place_in(self, region: Region, points: np.ndarray, cameras: Sequence[Camera]) -> None:
        """Also leave cells empty outside of the points' box, or that no camera shows (`mark_untrained_grid`).

        Random points have no box.
        """
        middle, largest = np.array(region.center), self.bound * region.radius
        ends = [points.min(axis=0), points.max(axis=0)] if self.has_measured_points else [[-np.inf] * 3, [np.inf] * 3]
        box, nears = np.stack(ends).clip(middle - largest, middle + largest), []
        for camera in cameras:
            pixels, z = camera.project(points)
            shown = z[camera.holds(pixels, z)]
            nears.append(float(np.percentile(shown, self.near_percentile)) if len(shown) else 0.0)
        self.field.region, occupancy = region, self.field.occupancy
        visible = visible_cells(occupancy.cells, region, box, cameras, nears)
        if not visible.any():
            raise ValueError(f"no training view shows a point within {self.bound:g} times the cameras' extent")
        occupancy.leave_empty(~visible.to(occupancy.densities.device))

    def begin(self, context: Context, outputs: Mapping[str, Output], whole: int) -> None:
        """Make the field of a stage and the parts around it; whole: iterations of all stages."""
        if self.learns_degC:
            scene = context.scene
            self.thermal_weight, self.zero = released_domain(None if scene.in_palette else scene.temperature)
        size, generator = self.begin_field(context), torch.Generator().manual_seed(context.seed)
        options = GridOptions(
            levels=self.levels,
            coarsest=self.cells[0],
            finest=self.cells[1],
            log2_rows=size.log2_rows,
            hidden=self.width,
            initial_density=self.initial_density,
            layers=self.layers,
        )
        density = DensityField(options, FEATURES, generator)
        heads = {}
        for name in dict.fromkeys(output.head for output in outputs.values()):
            columns = max(output.end for output in outputs.values() if output.head == name)
            sizes = FEATURES + DIRECTIONS, *[self.head_width] * self.head_layers, columns
            heads[name] = MLP(sizes, generator, sigmoid=True)
        occupancy = OccupancyGrid(2 ** ((size.log2_rows + 2) // 3))  # 128 of an axis with their tables of 2^19
        self.field = InstantField(density, occupancy, heads, self.steps * size.samples[0]).to(context.device)
        self.field.zero.fill_(self.zero)
        self.rate = falling(self.rates, max(1, round(self.rate_end * whole)))
        network = AveragedNetwork(self.field, self.rate, self.averaging, self.epochs, whole)
        self.part = context.add_part("field", network)
        self.begin_batches(context, outputs)

    def begin_batches(self, context: Context, outputs: Mapping[str, Output]) -> None:
        """Make what a stage draws rays and places by."""
        self.outputs = outputs
        self.batches = context.rays(tuple(outputs))
        self.jitter, self.places = context.random("jitter"), context.random("occupancy")
        self.count = context.add_part("ray_count", RayCount(self.size.rays))

    def step(self, iteration: int) -> Step:
        self.place()
        if (iteration - 1) % self.update_every == 0:
            everywhere = iteration <= FULL_UPDATES * self.update_every
            self.field.occupancy.update(lambda positions: self.field.density(positions)[0], self.places, everywhere)
        batch = self.batches.next(self.count.rays)
        shown = self.field(batch.rays, self.outputs, self.jitter)
        self.count.note(shown.points)
        terms = {name: (image - batch.pixels[name]).square().mean() for name, image in shown.images.items()}
        if "thermal" in terms:
            terms["thermal"] = self.thermal_weight * terms["thermal"]
        modality = "thermal" if "thermal" in terms else "rgb"
        render = Render(shown.images[modality][:, None], None, shown.transmittance[:, None])  # a column of pixels
        return Step(sum(terms.values()), terms, render, batch.pixels[modality][:, None])

    def rendered(self, rays: Rays, modality: str) -> Rendered:
        shown: Rendered = self.part.average(rays, {modality: self.outputs[modality]})
        return shown

    def values_at(self, positions: Tensor) -> Tensor:
        densities, features = self.field.density(positions)
        inputs = torch.cat([features, features.new_zeros(len(features), DIRECTIONS)], dim=1)
        return densities.sum() + sum(head(inputs).sum() for head in self.field.heads.values())

    @property
    def samples_of_step(self) -> int:
        return POINTS_OF_RAY * self.size.rays


def released_domain(temperature: TemperatureRange | None) -> tuple[float, float]:
    """Return the weight with which squared errors of image values are those of released targets, and the value of 0 °C.

    Released targets are temperatures over the scene's largest one (`--tv`, colmap_provider.py), of at least 0 °C, where
    their sigmoids begin. Without a range, or where it begins below 0 °C, image values count as they are: 1 and 0.

    >>> released_domain(TemperatureRange(20.0, 40.0))
    (0.25, -1.0)
    """
    if temperature is None or temperature.min < 0:
        return 1.0, 0.0
    span = temperature.max - temperature.min
    return (span / temperature.max) ** 2, -temperature.min / span


class Scratch(InstantThermal):
    """Thermal images alone, from scratch (`--ts`)."""

    def setup(self, context: Context) -> None:
        output = Output("image", 0, context.scene.channels)
        self.begin(context, {"thermal": output}, context.budget.schedule_length)


class SecondBranch(InstantThermal):
    """RGB-X: one head gives colour and temperature (`--rgbt`)."""

    modalities = ("thermal", "rgb")

    def setup(self, context: Context) -> None:
        outputs = {"rgb": Output("image", 0, 3), "thermal": Output("image", 3, 3 + context.scene.channels)}
        self.begin(context, outputs, context.budget.schedule_length)


@dataclass
class Separate(InstantThermal):
    """SC: a head for colour, another one for temperature, 0 °C behind temperatures (`--sc`)."""

    modalities = ("thermal", "rgb")

    temperature_moves_density: bool  # False: the gradient of the density leaves out the temperature

    def setup(self, context: Context) -> None:
        thermal = Output("temperature", 0, context.scene.channels, False, self.temperature_moves_density)
        self.begin(context, {"rgb": Output("image", 0, 3), "thermal": thermal}, context.budget.schedule_length)


@dataclass
class FineTune(InstantThermal):
    """FT: RGB first, then thermal images in three channels in the same network (`--temp` after a training without).

    The optimiser and the rate go on; rays and the updates of all cells start again. The network of RGB is kept for
    renders of RGB.
    """

    modalities = ("thermal", "rgb")
    learns_degC = False  # but pictures

    rgb_share: Annotated[float, Field(gt=0, lt=1)]  # of the iterations

    def stages(self) -> list[Stage]:
        return [
            Stage("rgb", self._set_up_rgb, self.step, self.rgb_share, "rgb"),
            Stage("thermal", self._set_up_thermal, self.step, 1 - self.rgb_share),
        ]

    def _set_up_rgb(self, context: Context) -> None:
        self.before = context.budget.schedule_length
        self.begin(context, {"rgb": Output("image", 0, 3)}, round(self.before / self.rgb_share))
        self.rgb_field, self.channels = self.part.average, context.scene.channels

    def _set_up_thermal(self, context: Context) -> None:
        self.part = context.add_part("field", copy.deepcopy(self.part))
        self.part.rate = lambda iteration: self.rate(self.before + iteration)
        self.part.before = self.before
        self.field = self.part.module
        self.begin_batches(context, {"thermal": Output("image", 0, 3)})

    def rendered(self, rays: Rays, modality: str) -> Rendered:
        field = self.rgb_field if modality == "rgb" else self.part.average
        shown: Rendered = field(rays, {modality: Output("image", 0, 3)})
        if modality == "thermal" and self.channels == 1:
            shown.images[modality] = shown.images[modality].mean(dim=1, keepdim=True)
        return shown

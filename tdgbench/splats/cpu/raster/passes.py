"""The two passes over one camera.

Forward: cull, project, list by tile, blend. Backward: from gradients of the images to those of the Gaussians, or to
their next state. Gaussians are cut into one span per thread; orders and sums do not depend on the spans, so neither do
results.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import AdamStep, new_flags, step_computed
from tdgbench.splats.cpu.raster.blend import blend_tiles
from tdgbench.splats.cpu.raster.blend_backward import fill_slots, slot_size
from tdgbench.splats.cpu.raster.culling import find_candidates
from tdgbench.splats.cpu.raster.projection import GATHERED
from tdgbench.splats.cpu.raster.projection_backward import NO_FUSED_STEP, NO_ROWS, SLOT, FusedStep, projection_backward
from tdgbench.splats.cpu.raster.projection_forward import project_candidates
from tdgbench.splats.cpu.raster.tiles import list_by_tile
from tdgbench.splats.cpu.raster.types import (
    ForwardPass,
    GaussianSource,
    GradientArrays,
    ImageArrays,
    Settings,
    Slots,
    Span,
)
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.registers import LANES
from tdgbench.splats.cpu.statistics import StatisticsArrays
from tdgbench.splats.gaussians import padded
from tdgbench.splats.gradients import Gradients, PendingGradients


def forward(source: GaussianSource, settings: Settings) -> ForwardPass:
    """Render one camera."""
    workspace, scratch = Workspace(), Workspace()  # what the backward pass reads again, and what it does not
    candidates, spans = find_candidates(source, settings, scratch)
    found = project_candidates(source, settings, candidates, spans, workspace, scratch)
    tiles = list_by_tile(found, workspace, scratch)
    active_blocks = workspace.take("active blocks", len(tiles.splat_ids), np.uint32)
    images, visits = blend_tiles(settings, found.splats, tiles, active_blocks)
    if found.has_nan:  # the Gaussian could have been anywhere
        for image in images:
            image[:] = np.nan
    return ForwardPass(
        images, found.projected, found.projected_spans, found.splats, found.splat_spans, tiles, visits,
        len(found.pair_tiles), workspace,
    )  # fmt: skip


@dataclass
class Blended(PendingGradients):
    """A view after the backward pass of its blend, before that of its projection."""

    source: GaussianSource
    settings: Settings
    view: ForwardPass
    slots: Slots
    workspace: Workspace  # holds the slots

    def __post_init__(self) -> None:
        view = self.view
        self.projected_spans, self.touched = view.projected_spans, 0
        self.projected, self.radii = map(torch.from_numpy, (view.projected.gaussian_ids, view.projected.radii))
        self.pairs, self.blended = len(view.tiles.splat_ids), int(view.visits.counts.sum())

    @property
    def columns(self) -> int:
        """Columns of a row of gradients."""
        return padded(self.settings.channels.columns.used)

    def compute(self, image_only: bool = False) -> Gradients:
        workspace = Workspace()
        capacity = -(-len(self.view.splats.values) // LANES) * LANES
        rows = GradientArrays(
            workspace.take("ids of gradients", capacity, np.int32),
            workspace.take("gradients", (capacity, 0 if image_only else self.columns), np.float32),
            workspace.take("image gradients", (capacity, 5 if self.settings.channels.absgrad else 3), np.float32),
        )
        spans = self._run(rows, [NO_FUSED_STEP] * len(self.view.splat_spans))
        return Gradients(
            spans, *map(torch.from_numpy, rows), self.projected_spans, self.projected, self.radii, self.pairs,
            self.blended, lease=(workspace, self.view.workspace),
        )  # fmt: skip

    def step(self, step: AdamStep, statistics: StatisticsArrays) -> np.ndarray:
        """Step the Gaussians that some pixel depends on, and add to their statistics.

        The step is of the rows that the source reads. Returns (spans, stride) float32: 1 in columns with a gradient
        that is not finite. Where the rows have more columns than a fused step holds, the gradients are stored first.
        """
        if padded(step.rows.columns) > GATHERED:
            computed = self.compute()
            self.touched = computed.touched
            return step_computed(computed, step, statistics)
        bad = new_flags(len(self.view.splat_spans), step)
        self.touched = sum(n for _, n in self._run(NO_ROWS, [FusedStep(step, statistics, flags) for flags in bad]))
        return bad

    def _run(self, rows: GradientArrays, steps: Sequence[FusedStep]) -> list[Span]:
        source, settings, view = self.source, self.settings, self.view
        shared = (source.parameters, settings.channels, settings.camera, view.splats, self.slots, rows)
        counts = pool.run(
            projection_backward, [(*span, *shared, step) for span, step in zip(view.splat_spans, steps, strict=True)]
        )
        return [(first, n) for (first, _), n in zip(view.splat_spans, counts)]


@functools.lru_cache(maxsize=4)
def _zeros(shape: tuple[int, ...]) -> np.ndarray:
    """A gradient of zeros, float32, which nobody writes."""
    return np.zeros(shape, np.float32)


def blend_backward(
    source: GaussianSource,
    settings: Settings,
    view: ForwardPass,
    color: np.ndarray | None,
    depth: np.ndarray | None,
    transmittance: np.ndarray | None,
) -> Blended:
    """Differentiate the blend, from gradients of color (H, W, colours), depth (H, W) and transmittance (H, W).

    Float32; None is zero.
    """
    gradients = ImageArrays(
        *(
            _zeros(image.shape) if gradient is None else np.ascontiguousarray(gradient, np.float32)
            for gradient, image in zip((color, depth, transmittance), view.images)
        )
    )
    workspace = Workspace()
    channels = settings.channels
    floats = slot_size(channels.colors + channels.depth, channels.absgrad)
    values = workspace.take("slots", view.pair_capacity * floats + SLOT, np.float32)  # they are read by whole registers
    slots = Slots(values, np.zeros(view.pair_capacity, np.bool_))
    fill_slots(settings, view, gradients, slots)
    return Blended(source, settings, view, slots, workspace)

"""The backward pass over one camera: from gradients of the images to those of the Gaussians."""

from __future__ import annotations

import numpy as np

from tdgbench.splats.columns import COLORS_AT, padded
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.blend_backward import fill_slots, slot_size
from tdgbench.splats.cpu.raster.projection_backward import projection_backward
from tdgbench.splats.cpu.raster.source import Source
from tdgbench.splats.cpu.raster.types import ForwardPass, GradientArrays, GradientRows, Images, Settings, Slots
from tdgbench.splats.cpu.scratch import Workspace
from tdgbench.splats.cpu.simd.registers import LANES


def backward(
    source: Source,
    settings: Settings,
    done: ForwardPass,
    color: np.ndarray | None,
    depth: np.ndarray | None,
    transmittance: np.ndarray | None,
) -> GradientRows:
    """Gradients of the parameters from those of color (H, W, colours), depth (H, W) and transmittance (H, W).

    Float32; None is zero.
    """
    gradients = Images(
        *(
            np.zeros_like(image) if gradient is None else np.ascontiguousarray(gradient)
            for gradient, image in zip((color, depth, transmittance), done.images)
        )
    )
    workspace, scratch = Workspace(), Workspace()
    floats = slot_size(len(settings.background) + settings.depth_channel)
    slots = Slots(
        scratch.take("slots", done.pair_capacity * floats, np.float32), np.zeros(done.pair_capacity, np.bool_)
    )
    fill_slots(settings, done, gradients, slots)
    capacity = -(-len(done.splats.values) // LANES) * LANES
    columns = padded(COLORS_AT + settings.channels.count_bases() * len(settings.background))
    rows = GradientArrays(
        workspace.take("ids of gradients", capacity, np.int32),
        workspace.take("gradients", (capacity, columns), np.float32),
        workspace.take("image gradients", (capacity, 3), np.float32),
    )
    arguments = (source.parameters, settings.channels, settings.camera, done.splats, slots, rows)
    counts = pool.run(projection_backward, [(*span, *arguments) for span in done.splat_spans])
    return GradientRows([(first, n) for (first, _), n in zip(done.splat_spans, counts)], rows, workspace)

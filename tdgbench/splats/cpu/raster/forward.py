"""The forward pass over one camera: cull, project, list by tile, blend.

Gaussians are cut into one span per thread. Orders and sums do not depend on the spans, so neither do results.
"""

from __future__ import annotations

import numpy as np

from tdgbench.splats.cpu.raster.blend import blend_tiles
from tdgbench.splats.cpu.raster.culling import find_candidates
from tdgbench.splats.cpu.raster.projection_forward import project
from tdgbench.splats.cpu.raster.source import Source
from tdgbench.splats.cpu.raster.tiles import TILE, list_by_tile
from tdgbench.splats.cpu.raster.types import ForwardPass, Settings
from tdgbench.splats.cpu.scratch import Workspace


def forward(source: Source, settings: Settings) -> ForwardPass:
    """Render one camera."""
    workspace, scratch = Workspace(), Workspace()  # what the backward pass reads again, and what it does not
    candidates, spans = find_candidates(source, settings, scratch)
    found = project(source, settings, candidates, spans, workspace, scratch)
    n_tiles = -(-settings.width // TILE) * -(-settings.height // TILE)
    tiles = list_by_tile(found, n_tiles, workspace, scratch)
    active_blocks = workspace.take("active blocks", len(tiles.splat_ids), np.uint32)
    images, visits = blend_tiles(settings, found.splats, tiles, active_blocks)
    if found.has_nan:  # the Gaussian could have been anywhere
        for image in images:
            image[:] = np.nan
    return ForwardPass(
        images, found.projected, found.projected_spans, found.splats, found.splat_spans, tiles, visits,
        len(found.pair_tiles), workspace,
    )  # fmt: skip

"""Pictures of one test view of a finished cell, in colour: ground truth, render, error, depth."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tdgbench.cells.folder import RENDERS, CellFolder
from tdgbench.present.colour_scale import ERROR_RANGE as ERROR_RANGE
from tdgbench.present.colour_scale import ColourScale, colour_scale
from tdgbench.present.colours import UNKNOWN, colored, expected_depth, in_colour
from tdgbench.scenes.modalities import THERMAL

ERROR, DEPTH = "magma", "viridis"  # colour maps


class ViewPictures(NamedTuple):
    """Pictures of a test view, (H, W, 3) uint8, gray where masked, and what their colours span."""

    truth: np.ndarray
    render: np.ndarray
    error: np.ndarray
    scale: ColourScale


def view_pictures(cell: CellFolder, view: str) -> ViewPictures:
    """Return the stored pictures of a test view in colour. Raises ValueError or OSError where one is unusable."""
    stored = cell.pictures(view)
    scale = colour_scale(stored.truth, stored.valid, cell.record.temperature_range)
    truth, render = (
        grayed(in_colour(one, scale.low, scale.high), stored.valid) for one in (stored.truth, stored.render)
    )
    return ViewPictures(truth, render, colored(stored.error, ERROR, 0, scale.error), scale)


def middle_view(cells: Iterable[CellFolder]) -> str:
    """Return the name of the middle test view that any of these cells has a render of; empty without any."""
    names = sorted({name for cell in cells for name in cell.views_with(RENDERS)})
    return names[len(names) // 2] if names else ""


def grayed(pixels: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return a picture (H, W, 3) uint8 that is gray where the mask (H, W) is false."""
    return pixels if valid is None else np.where(valid[..., None], pixels, np.uint8(UNKNOWN))


def rendered_depth(cell: CellFolder, view: str) -> np.ndarray:
    """Return z (H, W) of what a cell's method renders in a test view, NaN without a surface."""
    return expected_depth(cell.renderer(THERMAL)(view))

"""Pictures of one test view of a finished cell, in colour: ground truth, render, error, depth."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from tdgbench.cells.folder import RENDERS, CellFolder
from tdgbench.present.colours import UNKNOWN, colored, expected_depth, in_colour
from tdgbench.scenes.modalities import THERMAL

ERROR, DEPTH = "magma", "viridis"  # colour maps
ERROR_RANGE = 0.15  # upper end of the colour scale of errors


class ViewPictures(NamedTuple):
    """Pictures of a test view, (H, W, 3) uint8, and their mask, bool (H, W); None if all pixels are valid.

    Masked pixels are gray in the ground truth and in the error.
    """

    truth: np.ndarray
    render: np.ndarray
    error: np.ndarray
    valid: np.ndarray | None


def view_pictures(cell: CellFolder, view: str) -> ViewPictures:
    """Return the stored pictures of a test view in colour. Raises ValueError or OSError where one is unusable."""
    stored = cell.pictures(view)
    truth, error = grayed(in_colour(stored.truth), stored.valid), colored(stored.error, ERROR, 0, ERROR_RANGE)
    return ViewPictures(truth, in_colour(stored.render), error, stored.valid)


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

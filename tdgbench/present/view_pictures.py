"""Pictures of one test view of a finished cell, in colour: ground truth, render, error, depth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from tdgbench.cells.folder import RENDERS, CellFolder, CellPictures
from tdgbench.present.colour_scale import ColourScale, colour_scale, width_of
from tdgbench.present.colours import UNKNOWN, colored, expected_depth, in_colour
from tdgbench.scenes.modalities import THERMAL

ERROR, DEPTH = "magma", "viridis"  # colour maps


class ViewPictures(NamedTuple):
    """Pictures of a test view, (H, W, 3) uint8, gray where masked."""

    truth: np.ndarray
    render: np.ndarray
    error: np.ndarray


def view_pictures(cell: CellFolder, view: str, scale: ColourScale) -> ViewPictures:
    """Return the stored pictures of a test view in colour, equal °C in equal colours.

    Raises ValueError or OSError where one is unusable, or its °C are not those of the scale.
    """
    stored = cell.pictures(view)
    if stored.truth.shape[2] == 1:
        scale = scale.of_range(cell.record.temperature_range)
    truth, render = (
        grayed(in_colour(one, scale.low, scale.high), stored.valid) for one in (stored.truth, stored.render)
    )
    return ViewPictures(truth, render, colored(stored.error, ERROR, 0, scale.error))


def view_scale(cells: Iterable[CellFolder], view: str) -> ColourScale:
    """Return the scale of a test view for all of these cells: of the first ground truth that can be read."""
    usable = []
    for cell in cells:
        with suppress(OSError, ValueError):
            usable.append((cell.pictures(view), cell.record.temperature_range))
    return scale_of(usable) if usable else ColourScale()


def scale_of(pictures: Sequence[tuple[CellPictures, Sequence[float] | None]]) -> ColourScale:
    """Return the scale of pictures of one test view, with the °C of values 0 and 1: of the first ground truth.

    Errors of pictures whose values are unknown beside known °C, or the other way round, do not decide where it ends.
    """
    (truth, _, valid), degrees = pictures[0]
    comparable = [(one.error.ravel(), span) for one, span in pictures if (span is None) == (degrees is None)]
    errors = [error * (width_of(span) / width_of(degrees)) for error, span in comparable]
    return colour_scale(truth, valid, degrees, np.concatenate(errors))


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

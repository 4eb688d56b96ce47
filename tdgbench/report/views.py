"""Pictures of one test view: temperatures, errors, depth, and where the model guesses."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.bench.colours import UNKNOWN, expected_depth
from tdgbench.cells.paths import files_of
from tdgbench.scenes.modalities import THERMAL
from tdgbench.tables.cell import Cell

FILES = files_of(THERMAL)  # the report shows thermal images
ERROR, DEPTH = "magma", "viridis"
ERROR_RANGE = 0.15  # upper end of the colour scale of errors


def middle_view(folders: Iterable[Path]) -> str:
    """Return the name of the middle test view that any of these cells has a render of; empty without any."""
    names = sorted({path.stem for folder in folders for path in (folder / FILES.renders).glob("*.png")})
    return names[len(names) // 2] if names else ""


def embedded(pixels: np.ndarray) -> str:
    """Return a picture (H, W, 3) uint8 as a data URI."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def grayed(pixels: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Return a picture (H, W, 3) uint8 that is gray where the mask (H, W) is false."""
    return pixels if valid is None else np.where(valid[..., None], pixels, np.uint8(UNKNOWN))


def depth_of(cell: Cell, view: str) -> np.ndarray:
    """Return z (H, W) of what a cell's method renders in a test view, NaN without a surface."""
    return expected_depth(cell.renderer(THERMAL)(view))

"""Masked pixels in a cell: their share in its record, and `masks/`, the masks of its test views."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.cells.read_files import read_named
from tdgbench.scenes import View

FOLDER = "masks"


def masked_share(views: Iterable[View]) -> float:
    """Return the share of the views' pixels at which no thermal value was measured."""
    masked, pixels = 0, 0
    for view in views:
        pixels += view.camera.width * view.camera.height
        masked += 0 if view.valid is None else int(np.count_nonzero(~view.valid))
    return masked / max(pixels, 1)


def masked_in_words(masked: Mapping[str, float]) -> str:
    """Return the shares of masked pixels of a record as a sentence; empty if nothing is masked.

    >>> masked_in_words({"train": 0.125, "test": 0.1})
    '12.5 % of the training and 10.0 % of the test pixels have no thermal value; they count in no loss and no score'
    >>> masked_in_words({"train": 0.0, "test": 0.0})
    ''
    """
    train, test = masked.get("train", 0.0), masked.get("test", 0.0)
    if not train and not test:
        return ""
    shares = f"{100 * train:.1f} % of the training and {100 * test:.1f} % of the test pixels"
    return f"{shares} have no thermal value; they count in no loss and no score"


def write_mask(folder: Path, name: str, valid: np.ndarray) -> None:
    """Write the mask of a test view, bool (H, W), as a picture: 255 where a thermal value was measured, else 0."""
    path = mask_path(folder, name)
    path.parent.mkdir(exist_ok=True)
    Image.fromarray(valid.astype(np.uint8) * 255).save(path)


def has_mask(folder: Path, name: str) -> bool:
    """Return whether a test view has a stored mask."""
    return mask_path(folder, name).exists()


def read_mask(folder: Path, name: str, size: tuple[int, int] | None = None) -> np.ndarray:
    """Return the stored mask of a test view, bool (H, W). size: width and height that it must have, px.

    Raises ValueError, naming the picture, if it is no mask.
    """
    pixels = read_named(folder, f"{FOLDER}/{name}.png", size)
    if pixels.shape[2] != 1 or not np.isin(pixels, (0, 255)).all():
        raise ValueError(f"{FOLDER}/{name}.png is no mask: its values must be 0 and 255, in one channel")
    return pixels[..., 0] > 0


def mask_path(folder: Path, name: str) -> Path:
    """Return the place of a test view's mask in its cell's folder."""
    return folder / FOLDER / f"{name}.png"

"""Values as pictures: colour maps, and the text of one value."""

from __future__ import annotations

from functools import cache

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

COLOR_MAPS = ("inferno", "gray", "viridis", "magma", "plasma", "turbo", "coolwarm")
UNKNOWN = 128  # gray of pixels without a value
LEVELS = 256


@cache
def lookup_table(name: str) -> np.ndarray:
    """Return the colours (256, 3) uint8 of one of matplotlib's colour maps."""
    return (matplotlib.colormaps[name](np.linspace(0, 1, LEVELS))[:, :3] * 255 + 0.5).astype(np.uint8)


def colored(values: np.ndarray, name: str, low: float, high: float) -> np.ndarray:
    """Return values (H, W) float32 in a colour map from `low` to `high`: (H, W, 3) uint8; gray where they are NaN.

    >>> colored(np.array([[-1.0, 0.5, 2.0, np.nan]], np.float32), "gray", 0, 1)[0, :, 0].tolist()
    [0, 128, 255, 128]
    """
    scaled = values - np.float32(low)
    scaled *= np.float32(LEVELS / max(high - low, 1e-12))
    np.clip(scaled, 0, LEVELS - 1, out=scaled)
    unknown = np.isnan(scaled) if np.isnan(scaled.sum()) else None
    with np.errstate(invalid="ignore"):
        picture = lookup_table(name).take(scaled.astype(np.uint8), axis=0)
    if unknown is not None:
        picture[unknown] = UNKNOWN
    return picture


def as_rgb(picture: np.ndarray, name: str = "gray") -> np.ndarray:
    """Return a stored picture (H, W, 1 or 3) uint8 as (H, W, 3); gray in a colour map."""
    return picture if picture.shape[2] == 3 else lookup_table(name)[picture[..., 0]]


def wiped(left: np.ndarray, right: np.ndarray, share: float) -> np.ndarray:
    """Join two pictures (H, W, 3) of one size in one, divided by a white line after `share` of the width.

    >>> wiped(np.zeros((1, 4, 3), np.uint8), np.full((1, 4, 3), 9, np.uint8), 0.5)[0, :, 0].tolist()
    [0, 0, 255, 9]
    """
    divide = round(share * left.shape[1])
    joined = np.concatenate([left[:, :divide], right[:, divide:]], axis=1)
    if 0 < divide < left.shape[1]:
        joined[:, divide] = 255
    return joined


def labelled(picture: np.ndarray, share: float, left: str = "", right: str = "") -> np.ndarray:
    """Return a picture (H, W, 3) uint8 with names at the bottom, left and right of a share of its width."""
    image = Image.fromarray(picture)
    draw, divide, gap = ImageDraw.Draw(image), share * image.width, image.height / 80
    font = ImageFont.load_default(max(8.0, image.height / 36))
    for text, x, anchor in ((left, divide - gap, "rb"), (right, divide + gap, "lb")):
        draw.text((x, image.height - gap), text, "white", font, anchor, stroke_width=1, stroke_fill="black")
    return np.asarray(image)

"""Stored pictures and values in colour maps, as report and viewer show them."""

from __future__ import annotations

from functools import cache

import matplotlib
import numpy as np
import torch

from tdgbench.splats.view import Render

THERMAL = "inferno"  # colour map of gray thermal images
MIN_ALPHA = 0.5  # below, a pixel shows no surface
UNKNOWN = 128  # gray of pixels without a value
LEVELS = 256
GUESSED = (70, 160, 255)  # blue, which the colour maps of temperatures, errors and depth do not have


@cache
def lookup_table(name: str) -> np.ndarray:
    """Return the colours (256, 3) uint8 of one of matplotlib's colour maps."""
    return (matplotlib.colormaps[name](np.linspace(0, 1, LEVELS))[:, :3] * 255 + 0.5).astype(np.uint8)


def colored(values: np.ndarray, name: str, low: float, high: float) -> np.ndarray:
    """Return values (H, W) in a perceptual colour map from `low` to `high`: (H, W, 3) uint8; gray where they are NaN.

    >>> colored(np.array([[-1.0, 0.5, 2.0, np.nan]], np.float32), "gray", 0, 1)[0, :, 0].tolist()
    [0, 128, 255, 128]
    """
    scaled = np.asarray(values, np.float32) - np.float32(low)
    scaled *= np.float32(LEVELS / max(high - low, 1e-12))
    np.clip(scaled, 0, LEVELS - 1, out=scaled)
    unknown = np.isnan(scaled) if np.isnan(scaled.sum()) else None
    with np.errstate(invalid="ignore"):
        picture = lookup_table(name).take(scaled.astype(np.uint8), axis=0)
    if unknown is not None:
        picture[unknown] = UNKNOWN
    return picture


def shaded(picture: np.ndarray, determinacy: np.ndarray) -> np.ndarray:
    """Return a picture (H, W, 3) uint8 in blue where a model guesses: the lower the determinacy (H, W), the more.

    >>> shaded(np.full((1, 2, 3), 10, np.uint8), np.array([[1.0, 0.0]])).tolist()
    [[[10, 10, 10], [70, 160, 255]]]
    """
    known = determinacy[..., None]
    return np.asarray(known * picture + (1 - known) * np.array(GUESSED) + 0.5).clip(0, 255).astype(np.uint8)


def colours_of_levels(name: str, low: float, high: float) -> np.ndarray:
    """Return the colours (256, 3) uint8 of the levels 0 to 255, of values in [0, 1], in a map from `low` to `high`."""
    return colored(np.arange(LEVELS)[None] / (LEVELS - 1), name, low, high)[0]


def in_colour(picture: np.ndarray, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """Return a stored picture (H, W, 1 or 3) uint8 in colour, (H, W, 3); gray ones from `low` to `high`."""
    return picture if picture.shape[2] == 3 else colours_of_levels(THERMAL, low, high)[picture[..., 0]]


def expected_depth(render: Render) -> np.ndarray:
    """Return the expected z (H, W) of a render with depth, NaN where there is no surface."""
    return torch.where(render.alpha > MIN_ALPHA, render.requested_depth / render.alpha, torch.nan).numpy()

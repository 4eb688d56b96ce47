"""Resolution of the training images over a training: low at first, as far as their spectrum allows (DashGaussian)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tdgbench.scenes import View
from tdgbench.scenes.images import nearest_valid, resize
from tdgbench.training.budget import SCALES, PixelRule
from tdgbench.training.noise import noise_of
from tdgbench.training.spectrum import significant_amplitudes

MOSTLY = 0.5


def schedule(rule: PixelRule, views: list[View], gaussians: int, iterations: int) -> list[tuple[int, int]]:
    """Steps (last iteration, scale) of `Curriculum`, for the thermal images of the views.

    gaussians: at the start. Smaller images than one pixel for each of them save little, as they are projected anyway.
    """
    side = min(min(view.camera.width, view.camera.height) for view in views)
    pixels = min(view.camera.width * view.camera.height for view in views)
    scales = tuple(
        s for s in SCALES
        if s == 1 or (s <= rule.largest_scale and side // s >= rule.smallest_side and pixels >= gaussians * s**2)
    )  # fmt: skip
    shares = np.mean([_shares(view, scales) for view in views], axis=0)
    ends = [int(share * rule.until * iterations) for share in shares]
    return [(end, scale) for end, scale in zip(ends, scales, strict=True) if scale > 1 and end > 0]


def _shares(view: View, scales: tuple[int, ...]) -> np.ndarray:
    """Shares (scales,) of the amplitudes of a view's thermal image. The border of a mask is no detail."""
    filled = nearest_valid(view.thermal, view.valid)
    return significant_amplitudes(filled, noise_of(view.thermal, view.valid), scales)


def shrunk(view: View, scale: int) -> View:
    """A view with 1/scale of the width and height, rounded; each pixel is the mean of the valid pixels in its area.

    A pixel is valid if half of its area is; if there is no such pixel, the most valid ones are.
    """
    width, height = (max(1, round(side / scale)) for side in (view.camera.width, view.camera.height))
    images = {"load_thermal": _later(resize(view.thermal, width, height)), "load_valid": None}
    if view.valid is not None:
        share = resize(view.valid[..., None].astype(np.float32), width, height)
        valid = share[..., 0] >= min(MOSTLY, float(share.max()))
        means = resize(view.thermal, width, height) / np.maximum(share, 1e-6)  # masked pixels are 0
        images = {"load_thermal": _later(np.where(valid[..., None], means, np.float32(0))), "load_valid": _later(valid)}
    load_rgb = None if view.load_rgb is None else lambda: resize(view.rgb, width, height)
    return replace(view, camera=view.camera.resized(width, height), load_rgb=load_rgb, **images)  # type: ignore[arg-type]


def _later(array: np.ndarray):
    return lambda: array

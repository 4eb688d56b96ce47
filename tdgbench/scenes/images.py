"""Read image files as float32 arrays in [0, 1]: 8-bit gray and colour, 16-bit radiometric, float TIFF in °C."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image, UnidentifiedImageError

from tdgbench.scenes.scene import SceneError, TemperatureRange

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


@dataclass(frozen=True)
class Radiometry:
    """Content of `temperature.json`. 16-bit images: degC = counts × degC_per_count + degC_at_zero."""

    range: TemperatureRange
    degC_per_count: float | None = None
    degC_at_zero: float = 0.0


def read_radiometry(path: Path) -> Radiometry | None:
    """Read `temperature.json`; None if there is no such file.

    Keys: min and max in °C; degC_per_count and degC_at_zero for 16-bit images. Raises SceneError.
    """
    if not path.exists():
        return None
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        low, high = float(content["min"]), float(content["max"])
        per_count = content.get("degC_per_count")
        if not low < high:
            raise ValueError(f"min {low} is not below max {high}")
        return Radiometry(
            TemperatureRange(low, high),
            None if per_count is None else float(per_count),
            float(content.get("degC_at_zero", 0.0)),
        )
    except (ValueError, KeyError, TypeError) as error:
        raise SceneError(f"{path} must hold numbers `min` < `max` in °C: {error!r}") from error


def read_image(path: Path, radiometry: Radiometry | None = None) -> np.ndarray:
    """Read an image as float32 (H, W, 1 or 3) in [0, 1].

    8-bit values are divided by 255. 16-bit values are divided by 65 535, or mapped to °C where `radiometry` says how.
    Float images are in °C. Temperatures are scaled to the range of `radiometry`. Raises SceneError naming the file.
    """
    try:
        with Image.open(path) as opened:
            image: Image.Image = opened
            if image.mode in ("P", "RGBA", "CMYK", "YCbCr", "LA", "1"):
                image = image.convert("L" if image.mode in ("LA", "1") else "RGB")
            values, mode = np.asarray(image), image.mode
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise SceneError(f"{path} cannot be read as an image: {error}") from error
    if values.ndim == 2:
        values = values[:, :, None]
    if values.dtype == np.uint8:
        return values.astype(np.float32) / np.float32(255)
    degC = None
    if np.issubdtype(values.dtype, np.floating):
        degC = values.astype(np.float64)
    elif radiometry is not None and radiometry.degC_per_count is not None:
        degC = values.astype(np.float64) * radiometry.degC_per_count + radiometry.degC_at_zero
    if degC is not None:
        if radiometry is None:
            raise SceneError(f"{path} holds temperatures; add temperature.json with `min` and `max` in °C")
        if not np.isfinite(degC).all():
            raise SceneError(f"{path} holds {int((~np.isfinite(degC)).sum())} pixels that are not finite")
        low, high = radiometry.range.min, radiometry.range.max
        return np.clip((degC - low) / (high - low), 0, 1).astype(np.float32)
    if values.min() < 0 or values.max() > 65535:
        raise SceneError(f"{path} (mode {mode}) has values outside 0 to 65535")
    return (values / 65535.0).astype(np.float32)


def is_gray(image: np.ndarray) -> bool:
    """Whether all channels of an image (H, W, C) are equal.

    >>> is_gray(np.full((2, 2, 3), 0.5)), is_gray(np.array([[[0.1, 0.2, 0.3]]]))
    (True, False)
    """
    return image.shape[2] == 1 or bool((image == image[..., :1]).all())


def resize(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resample an image (H, W, C) to (height, width, C): area average to shrink, bilinear to grow.

    >>> resize(np.array([[[0.0], [1.0]], [[1.0], [2.0]]], np.float32), width=1, height=1)
    array([[[1.]]], dtype=float32)
    """
    if image.shape[:2] == (height, width):
        return image
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    method = Image.Resampling.BOX if shrinks else Image.Resampling.BILINEAR
    planes = [Image.fromarray(np.ascontiguousarray(image[..., c])) for c in range(image.shape[2])]
    return np.stack([np.asarray(plane.resize((width, height), method)) for plane in planes], axis=-1)

"""Images as float32 arrays in [0, 1], and what is done with arrays of pixels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image
from scipy.ndimage import distance_transform_edt

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import MOST_COUNTS, Decoded, agreed_scale, decode, raw_counts
from tdgbench.scenes.temperature import TEMPERATURES, Radiometry

if TYPE_CHECKING:
    from tdgbench.scenes.scene import Scene, View


MOST_CHROMA = 5.0  # levels; a camera's white-hot JPEG has up to 3, and decoding rounds each channel


def read_image(path: Path) -> np.ndarray:
    """Read a picture as float32 (H, W, 1 or 3) in [0, 1]. Raises SceneError, also where pixels are transparent."""
    decoded = decode(path, as_picture=True)
    if decoded.valid is not None:
        raise SceneError(f"{path} has transparent pixels, and nobody knows what lies behind; save it without alpha")
    return unit_image(decoded, path)


def unit_image(decoded: Decoded, path: Path, radiometry: Radiometry | None = None) -> np.ndarray:
    """Return the pixels of 8 or 16 bits as float32 (H, W, 1 or 3) in [0, 1].

    8-bit values are divided by 255. 16-bit values are divided by 65 535 or, where the file or `radiometry` states their
    °C, scaled to the range of `radiometry`. Raises SceneError naming the file.
    """
    values, found = decoded.values, decoded.header
    if found.depth == "8-bit":
        result = values.astype(np.float32)
        result /= np.float32(255)
        return result
    if found.depth == "float":
        raise SceneError(f"{path} holds float values, as thermal images in °C alone may; save it with 8 or 16 bits")
    if radiometry is None or not (scale := agreed_scale(path, found, radiometry.scale)).is_known:
        return (raw_counts(values, path) / float(MOST_COUNTS)).astype(np.float32)
    degC = scale.degC(values)
    wrong = ~((degC >= TEMPERATURES[0]) & (degC <= TEMPERATURES[1]))
    if wrong.any():
        raise SceneError(
            f"{path} holds {int(wrong.sum())} pixels that are outside {TEMPERATURES[0]} to {TEMPERATURES[1]:g} °C; is "
            "degC_per_count in temperature.json right?"
        )
    low, high = radiometry.range.min, radiometry.range.max
    return np.clip((degC - low) / (high - low), 0, 1).astype(np.float32)


def thermal_image(decoded: Decoded, path: Path, radiometry: Radiometry | None = None) -> tuple[np.ndarray, str]:
    """Return a shown thermal image as `unit_image` does, with one channel where it is gray, and what is assumed.

    A lossy picture is gray if its chroma is no more than noise. Raises SceneError.
    """
    values = nearest_valid(decoded.values, decoded.valid)
    luma = without_chroma(values) if decoded.header.is_lossy else None
    image = unit_image(replace(decoded, values=values if luma is None else luma), path, radiometry)
    has_chroma = luma is not None and not is_gray(values)
    said = f"gray but for chroma of up to {MOST_CHROMA:g} levels, which is left out" if has_chroma else ""
    return np.ascontiguousarray(image[..., :1]) if is_gray(image) else image, said


def is_gray(image: np.ndarray) -> bool:
    """Return whether all channels of an image (H, W, C) are equal.

    >>> is_gray(np.full((2, 2, 3), 0.5)), is_gray(np.array([[[0.1, 0.2, 0.3]]]))
    (True, False)
    """
    return image.shape[2] == 1 or bool((image == image[..., :1]).all())


def without_chroma(values: np.ndarray) -> np.ndarray | None:
    """Return the luma (H, W, 1) uint8 of a lossy picture (H, W, 3) uint8 that is gray but for noise in its chroma.

    None if it has one channel, or a pixel whose Cb or Cr of JFIF is more than MOST_CHROMA levels from gray.

    >>> without_chroma(np.array([[[100, 99, 102]]], np.uint8)), without_chroma(np.array([[[100, 90, 120]]], np.uint8))
    (array([[[100]]], dtype=uint8), None)
    """
    if values.shape[2] == 1:
        return None
    r, g, b = np.moveaxis(values.astype(np.float32), -1, 0)
    luma = 0.299 * r + 0.587 * g + 0.114 * b
    if max(np.abs(b - luma).max() / 1.772, np.abs(r - luma).max() / 1.402) > MOST_CHROMA:
        return None
    return luma.round().astype(np.uint8)[..., None]


def in_pseudo_colour(views: Iterable[View]) -> list[str]:
    """Return names of the views whose thermal images are pseudo-colour: their values are no temperatures."""
    return [view.name for view in views if not is_gray(view.thermal)]


def degC_of_values(scene: Scene) -> list[float] | None:
    """Return °C of a scene's thermal values 0 and 1; None if they are not known, or pseudo-colour."""
    span, is_gray = scene.temperature, not (scene.in_palette or in_pseudo_colour(scene.test))
    return None if span is None or not is_gray else [span.min, span.max]


def with_channels(image: np.ndarray, channels: int) -> np.ndarray:
    """Return an image (H, W, C) with 1 or 3 channels: gray is repeated, colours are averaged.

    >>> with_channels(np.array([[[0.0, 0.5, 1.0]]]), 1).tolist(), with_channels(np.array([[[0.5]]]), 3).tolist()
    ([[[0.5]]], [[[0.5, 0.5, 0.5]]])
    """
    if image.shape[2] == channels:
        return image
    return np.repeat(image, 3, axis=2) if channels == 3 else image.mean(axis=2, keepdims=True)


def nearest_valid(image: np.ndarray, valid: np.ndarray | None) -> np.ndarray:
    """Replace each masked pixel of an image (H, W) or (H, W, C) by the nearest valid one; None: all are valid.

    >>> nearest_valid(np.array([[1.0, 9.0, 2.0]]), np.array([[True, False, False]])).tolist()
    [[1.0, 1.0, 1.0]]
    """
    if valid is None or not valid.any():
        return image
    nearest = distance_transform_edt(~valid, return_distances=False, return_indices=True)
    return image[tuple(nearest)]


def resize(image: np.ndarray, width: int, height: int, method: Image.Resampling | None = None) -> np.ndarray:
    """Resample an image (H, W, C) to (height, width, C): area average to shrink, bilinear to grow, or by a method.

    >>> resize(np.array([[[0.0], [1.0]], [[1.0], [2.0]]], np.float32), width=1, height=1)
    array([[[1.]]], dtype=float32)
    >>> resize(np.array([[[0.0], [3.0], [6.0]]], np.float32), width=2, height=1).ravel()
    array([1., 5.], dtype=float32)
    """
    if image.shape[:2] == (height, width):
        return image
    rows, columns = image.shape[:2]
    if method is None and width <= columns and height <= rows:
        if rows % height or columns % width:  # Pillow's BOX gives each pixel to one result, as a whole
            return _area_average(_area_average(image, height).swapaxes(0, 1), width).swapaxes(0, 1)
        method = Image.Resampling.BOX
    method = Image.Resampling.BILINEAR if method is None else method
    planes = [Image.fromarray(np.ascontiguousarray(image[..., c])) for c in range(image.shape[2])]
    return np.stack([np.asarray(plane.resize((width, height), method)) for plane in planes], axis=-1)


def _area_average(image: np.ndarray, count: int) -> np.ndarray:
    """Return the means (count, W, C) of equal parts of an image's (H, W, C) rows, which share rows at their edges."""
    rows = len(image)
    edges = np.linspace(0, rows, count + 1)
    first = np.floor(edges[:-1, None]).astype(int)
    places = first + np.arange(-(-rows // count) + 1)  # of rows that a part may touch
    touched = np.minimum(edges[1:, None], places + 1) - np.maximum(edges[:-1, None], places)
    shares = np.clip(touched, 0, None) * (count / rows)
    places = np.where(shares > 0, places, first)  # NaN of a row that a part does not touch is not read
    parts = (share[:, None, None] * image[place] for share, place in zip(shares.T, places.T, strict=True))
    return np.asarray(sum(parts), np.float32)

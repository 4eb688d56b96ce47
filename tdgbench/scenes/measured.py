"""Thermal images of a scene: decoded once, masked, undistorted, resized, cached until views take them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.colmap import RegisteredImage
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import is_gray, read_image, resize
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import Radiometry

ASPECT_TOLERANCE = 0.01
UNMEASURED = 0.0  # image value of pixels that are not valid


@dataclass(frozen=True)
class ImageSource:
    """Files of a view's thermal image, its camera, and the size that it is resampled to."""

    path: Path
    posed: RegisteredImage
    width: int  # px
    height: int  # px
    mask: Path | None = None


class Measured(NamedTuple):
    """A thermal image, and where it was measured."""

    image: np.ndarray  # (H, W, C) float32
    valid: np.ndarray | None  # (H, W) bool; None: everywhere


class CachedImage:
    """What a view's image and mask were made into, each cached until it is taken. Taken again, they are made again.

    So a scene reads each image once, although it must know all of them to tell its channels or its range of
    temperatures, and holds none beside those that its views hold.
    """

    def __init__(self, made: Measured, make: Callable[[], Measured]) -> None:
        self.channels = made.image.shape[2]
        self.is_masked = made.valid is not None
        self._image: np.ndarray | None = made.image
        self._valid = made.valid
        self._make = make

    def image(self) -> np.ndarray:
        image, self._image = self._image, None
        return self._make().image if image is None else image

    def valid(self) -> np.ndarray:
        """Return the mask (H, W) bool of a view that is masked."""
        valid, self._valid = self._valid, None
        valid = self._make().valid if valid is None else valid
        if valid is None:
            raise ValueError("all pixels of this view are valid")
        return valid


@dataclass(frozen=True)
class ThermalImages:
    """Thermal images of a scene, by view name. counts: raw counts of the image values 0 and 1, of images without °C."""

    cached: Mapping[str, CachedImage]
    channels: int
    temperature: TemperatureRange | None
    notes: list[str] = field(default_factory=list)
    counts: tuple[int, int] | None = None

    def load(self, name: str) -> np.ndarray:
        """Return the image (H, W, channels) float32 in [0, 1] of a view."""
        image = self.cached[name].image()
        if self.channels == 1 and image.shape[2] == 3:
            image = image[..., :1] if is_gray(image) else image.mean(axis=2, keepdims=True)
        if self.channels == 3 and image.shape[2] == 1:
            image = np.repeat(image, 3, axis=2)
        return np.ascontiguousarray(image, np.float32)


def shown_images(sources: Mapping[str, ImageSource], radiometry: Radiometry | None, wanted: int | str) -> ThermalImages:
    """Read images as their files show them. wanted: number of channels, 1, 3 or `auto`. Raises SceneError."""
    cached = {}
    for name, source in sources.items():
        make = partial(_read_shown, source, radiometry)
        cached[name] = CachedImage(make(), make)
    channels = decide_channels(wanted, all(view.channels == 1 for view in cached.values()))
    return ThermalImages(cached, channels, None if radiometry is None else radiometry.range)


def decide_channels(wanted: int | str, are_gray: bool) -> int:
    """Return the number of channels of a scene's images. Raises SceneError for another wish than 1, 3 or `auto`."""
    if wanted not in ("auto", 1, 3):
        raise SceneError(f"data.channels is {wanted!r}; it must be auto, 1 or 3")
    return (1 if are_gray else 3) if wanted == "auto" else int(wanted)


def _read_shown(source: ImageSource, radiometry: Radiometry | None) -> Measured:
    image = read_image(source.path, radiometry)
    if is_gray(image):
        image = np.ascontiguousarray(image[..., :1])
    image, valid = resample(image, read_hidden(source, image), source)
    if valid is not None:
        image[~valid] = UNMEASURED
    return Measured(image, valid)


def read_hidden(source: ImageSource, image: np.ndarray) -> np.ndarray | None:
    """Read the pixels (H, W) bool of an image (H, W, C) that the view's mask hides, or None. Raises SceneError.

    A mask hides where all its channels are 0. One of another size is resized; a pixel that is partly hidden is hidden.
    """
    if source.mask is None:
        return None
    mask = read_image(source.mask)
    check_aspect(source.mask, mask, source.posed)
    hidden = (mask == 0).all(axis=2, keepdims=True).astype(np.float32)
    return resize(hidden, image.shape[1], image.shape[0])[..., 0] > 0


def resample(
    image: np.ndarray, invalid: np.ndarray | None, source: ImageSource
) -> tuple[np.ndarray, np.ndarray | None]:
    """Undistort and resize an image (H, W, C) whose `invalid` pixels (H, W) bool count for nothing.

    Returns the image (height, width, C) and its valid pixels (height, width) bool, those that are made of valid pixels
    alone; None if all are. Raises SceneError if none is, or if image and camera have different aspect ratios.
    """
    check_aspect(source.path, image, source.posed)
    if invalid is None or not invalid.any():
        return _resample(image, source), None
    spoiled = _resample(invalid[..., None].astype(np.float32), source)[..., 0] > 0  # weights are not negative
    if spoiled.all():
        raise SceneError(
            f"{source.path} has no valid pixel: all of them are masked, or not measured; correct its mask or its "
            "values, or leave the view out"
        )
    return _resample(np.where(invalid[..., None], np.float32(0), image), source), ~spoiled


def _resample(image: np.ndarray, source: ImageSource) -> np.ndarray:
    if source.posed.undistortion is not None:
        image = source.posed.undistortion.apply(image)
    return resize(image, source.width, source.height)


def check_aspect(path: Path, image: np.ndarray, posed: RegisteredImage) -> None:
    """Raise SceneError unless an image (H, W, ...) has the aspect ratio of its camera."""
    height, width = image.shape[:2]
    source = posed.source_size
    if abs(width / height * source[1] / source[0] - 1) > ASPECT_TOLERANCE:
        raise SceneError(
            f"{path} is {width}×{height}, but its camera is {source[0]}×{source[1]}: the aspect ratios differ; "
            "export the image again, or correct the camera"
        )

"""Images of a scene's views: read, masked, undistorted and resized to the view's camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.camera import Camera
from tdgbench.scenes.colmap import RegisteredImage
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import Header, decode
from tdgbench.scenes.images import resize, thermal_image, with_channels
from tdgbench.scenes.scene import PALETTE, TemperatureRange
from tdgbench.scenes.temperature import Radiometry

ASPECT_TOLERANCE = 0.01
UNMEASURED = 0.0  # image value of pixels that are not valid


class Mask(NamedTuple):
    """A picture that hides pixels of a view: where it is black; inverted: where it is not."""

    path: Path
    inverted: bool = False


@dataclass(frozen=True)
class ImageSource:
    """Files of a view's thermal image, its camera, and the size that it is resampled to."""

    path: Path
    posed: RegisteredImage
    width: int  # px
    height: int  # px
    mask: Mask | None = None
    header: Header | None = None  # None: it cannot be read


class MaskedImage(NamedTuple):
    """An image, and where it was measured."""

    image: np.ndarray  # (H, W, C) float32
    valid: np.ndarray | None  # (H, W) bool; None: everywhere


@dataclass(frozen=True)
class ThermalImages:
    """Thermal images of a scene, by view name. raw_count_range: of image values 0 and 1, without °C."""

    images: Mapping[str, MaskedImage]
    channels: int
    temperature: TemperatureRange | None
    notes: list[str] = field(default_factory=list)
    raw_count_range: tuple[int, int] | None = None
    assumed: dict[str, str] = field(default_factory=dict)  # as of Scene
    doubts: list[str] = field(default_factory=list)


def shown_images(sources: Mapping[str, ImageSource], radiometry: Radiometry | None, wanted: int | str) -> ThermalImages:
    """Read images as their files show them. wanted: number of channels, 1, 3 or `auto`. Raises SceneError."""
    images, said = {}, dict[str, None]()
    for name, source in sources.items():
        images[name], words = _read_shown(source, radiometry)
        said[words] = None
    are_gray = all(view.image.shape[2] == 1 for view in images.values())
    channels = (1 if are_gray else 3) if wanted == "auto" else int(wanted)
    images = {name: in_channels(view, channels) for name, view in images.items()}
    is_palette_made_gray = channels == 1 and not are_gray
    span = None if radiometry is None or is_palette_made_gray else radiometry.range
    known = "of unknown °C" if span is None else f"0 and 1 are {span.min:.4g} and {span.max:.4g} °C"
    assumed = {"values": f"gray, {known}" if are_gray else PALETTE}
    return ThermalImages(images, channels, span, [words for words in said if words], assumed=assumed)


def in_channels(view: MaskedImage, channels: int) -> MaskedImage:
    """Return a thermal image with 1 or 3 channels."""
    return MaskedImage(np.ascontiguousarray(with_channels(view.image, channels), np.float32), view.valid)


def _read_shown(source: ImageSource, radiometry: Radiometry | None) -> tuple[MaskedImage, str]:
    decoded = decode(source.path, as_picture=True)
    image, said = thermal_image(decoded, source.path, radiometry)
    image, valid = resample(image, hidden_by(source, image, decoded.valid), source)
    if valid is not None:
        image[~valid] = UNMEASURED
    return MaskedImage(image, valid), said


def hidden_by(source: ImageSource, image: np.ndarray, valid: np.ndarray | None = None) -> np.ndarray | None:
    """Return the pixels (H, W) bool of an image (H, W, C) that its file or the view's mask hides, or None.

    valid: (H, W) bool, of its file. A mask hides where all its channels are 0; an inverted one, where they are not. In
    a JPEG, whose levels are rounded, values below the middle count as 0. A mask of another size is resized, and hides
    what it partly hides. Raises SceneError.
    """
    if source.mask is None:
        return None if valid is None else ~valid
    path = source.mask.path
    mask = decode(path, as_picture=True)
    check_aspect(path, mask.values, source.posed)
    middle = 128 if mask.header.is_lossy else 1
    dark = (mask.values < middle).all(axis=2)
    hidden = np.asarray(~dark if source.mask.inverted else dark)
    if mask.valid is not None:
        hidden |= ~mask.valid
    hidden = resize(hidden[..., None].astype(np.float32), image.shape[1], image.shape[0])[..., 0] > 0
    return hidden if valid is None else hidden | ~valid


def resample(image: np.ndarray, invalid: np.ndarray | None, source: ImageSource) -> MaskedImage:
    """Undistort and resize an image (H, W, C) whose `invalid` pixels (H, W) bool count for nothing.

    A pixel of the result is valid if it is made of valid pixels alone. Raises SceneError if none is, or if image and
    camera have different aspect ratios.
    """
    check_aspect(source.path, image, source.posed)
    if invalid is None or not invalid.any():
        return MaskedImage(_resample(image, source), None)
    spoiled = _resample(invalid[..., None].astype(np.float32), source)[..., 0] > 0  # weights are not negative
    if spoiled.all():
        raise SceneError(
            f"{source.path} has no valid pixel: all of them are masked, or not measured; correct its mask or its "
            "values, or leave the view out"
        )
    return MaskedImage(_resample(np.where(invalid[..., None], np.float32(0), image), source), ~spoiled)


def _resample(image: np.ndarray, source: ImageSource) -> np.ndarray:
    if source.posed.undistortion is not None:
        image = source.posed.undistortion.apply(image)
    return resize(image, source.width, source.height)


def native_camera(posed: RegisteredImage, size: tuple[int, int] | None) -> Camera:
    """Return the pinhole of a view's images of a size, (width, height) in px; None: the camera's. As 3DGS does.

    COLMAP may have run on images of another size, as on RGB ones; the intrinsics follow the image.
    """
    camera = posed.camera
    if size is None or size == posed.source_size:
        return camera
    undistortion = posed.undistortion
    return camera.resized(*(size if undistortion is None else undistortion.size_for(*size)))


def check_aspect(path: Path, image: np.ndarray, posed: RegisteredImage) -> None:
    """Raise SceneError unless an image (H, W, ...) has the aspect ratio of its camera."""
    height, width = image.shape[:2]
    source = posed.source_size
    if abs(width / height * source[1] / source[0] - 1) > ASPECT_TOLERANCE:
        is_turned = abs(height / width * source[1] / source[0] - 1) <= ASPECT_TOLERANCE
        remedy = "turn the image upright" if is_turned else "export the image again, or correct the camera"
        raise SceneError(
            f"{path} is {width}×{height}, but its camera is {source[0]}×{source[1]}: the aspect ratios differ; {remedy}"
        )

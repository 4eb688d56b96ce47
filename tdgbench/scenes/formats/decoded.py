"""What a file of pixels is, before and after it is decoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple

import numpy as np

from tdgbench.scenes.camera import MAX_PIXELS
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.temperature import CountScale

HEAD = 64  # bytes by which containers are told apart
NO_SCALE = CountScale()

Depth = Literal["8-bit", "16-bit", "float"]
Meaning = Literal["shown", "counts", "°C"]


@dataclass
class Source:
    """A file whose content is read once. as_picture: of a camera's JPEG, the picture is wanted that viewers show."""

    path: Path
    file: BinaryIO
    as_picture: bool = False

    @cached_property
    def head(self) -> bytes:
        self.file.seek(0)
        return self.file.read(HEAD)


class Header(NamedTuple):
    """What a file says of its pixels. Integers of more than 8 bits in one channel are counts, floats are in °C."""

    format: str  # as messages name it
    width: int  # px, of the values
    height: int
    depth: Depth
    meaning: Meaning
    scale: CountScale = NO_SCALE  # of counts, if the file states it
    assumed: tuple[str, ...] = ()
    remedy: str = ""  # how to get °C of counts without a scale
    camera: str = ""  # whose own format it is
    is_lossy: bool = False  # levels are rounded
    may_be_shown: bool = False  # counts may as well be levels of a picture of 16 bits

    def checked(self, path: Path) -> Header:
        """Return this header. Raises SceneError as `check_pixels`."""
        check_pixels(self.width, self.height, path)
        return self


@dataclass(frozen=True)
class PhotoMapping:
    """Where the thermal image lies in the embedded photo, as the camera states it (FLIR's picture-in-picture record).

    The thermal image covers 1 / real_to_ir of the photo's width; its centre lies (offset_x, offset_y) px of the photo
    right of and below the photo's centre (flyr/thermogram.py, `picture_in_picture_pil`).
    """

    real_to_ir: float
    offset_x: float  # px of the photo
    offset_y: float


@dataclass(frozen=True)
class Decoded:
    """Pixels in the depth that the file has, and what they mean.

    values: (H, W, 1 or 3): uint8 or uint16 of shown images, integers of counts, floats of °C. valid: (H, W) bool, false
    where the file says that there is no value; None: all are valid. photo: (h, w, 3) uint8, embedded beside the values;
    lost: why it cannot be decoded. settings: of the camera: emissivity, distance in m, temperatures in K.
    """

    values: np.ndarray
    header: Header
    valid: np.ndarray | None = None
    photo: np.ndarray | None = None
    lost: str = ""
    mapping: PhotoMapping | None = None
    settings: dict[str, float] = field(default_factory=dict)

    @property
    def settings_in_words(self) -> str:
        """The settings; empty without them."""
        if not (found := self.settings):
            return ""
        return (
            f"emissivity {found['emissivity']:.2f}, distance {found['object_distance']:g} m, reflected "
            f"{found['reflected_apparent_temperature'] - 273.15:.1f} °C, window transmission "
            f"{found['ir_window_transmission']:.2f}, relative humidity {100 * found['relative_humidity']:.0f} %"
        )


class Format(NamedTuple):
    """A container, or a camera's use of one. header and decode raise SceneError, or what their library raises."""

    name: str
    suffixes: tuple[str, ...]
    fits: Callable[[Source], bool]
    header: Callable[[Source], Header]
    decode: Callable[[Source], Decoded]


def check_pixels(width: int, height: int, path: Path) -> None:
    """Raise SceneError for none, or for more pixels than an image may have; before they are decoded."""
    if not 0 < width * height <= MAX_PIXELS:
        raise SceneError(f"{path} is {width}×{height} px; an image may have {MAX_PIXELS} pixels. Resize it")


def without_alpha(values: np.ndarray, most: float, path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """Return the channels (H, W, 1 or 3) before the last one, alpha, and which pixels are opaque (None: all).

    A pixel that is partly transparent holds a mixture, so it is not valid. Raises SceneError if none is opaque.
    """
    opaque = values[..., -1] >= most
    if not opaque.any():
        raise SceneError(f"{path} is transparent everywhere; save it without an alpha channel")
    return values[..., :-1], None if opaque.all() else opaque

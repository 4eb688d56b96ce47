"""Files of pixels: each format is a module, named in FORMATS; the first that fits reads a file.

Libraries decode. What a file states of its pixels (channels, bits, pages, alpha, no-data) is honoured or refused.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.files import opened
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.fillers import impossible
from tdgbench.scenes.formats.array import ARRAY
from tdgbench.scenes.formats.decoded import NO_SCALE, Decoded, Depth, Format, Header, PhotoMapping, Source
from tdgbench.scenes.formats.dji import DJI
from tdgbench.scenes.formats.flir import FLIR
from tdgbench.scenes.formats.pictures import PICTURE, pillow
from tdgbench.scenes.formats.tiff import TIFF
from tdgbench.scenes.formats.unread import EXPORT
from tdgbench.scenes.inputs import decoding, read_bytes, regular_file
from tdgbench.scenes.temperature import TEMPERATURES, CountScale

FORMATS: tuple[Format, ...] = (ARRAY, TIFF, FLIR, DJI, PICTURE)
SUFFIXES = tuple(suffix for one in reversed(FORMATS) for suffix in one.suffixes)
MOST_COUNTS = 65535  # of 16 bits
# K per count. Duo Pro R User Guide 1.0, p. 39: 0.04 (range -25 to 135 °C), 0.40 (-40 to 550 °C); Duo's, 5.1.7.3.1: 0.01
TLINEAR_GAINS = (0.01, 0.04, 0.4)

__all__ = ["FORMATS", "MOST_COUNTS", "NO_SCALE", "SUFFIXES", "Decoded", "Depth", "Header", "PhotoMapping", "Source",
           "agreed_scale", "celsius_of", "decode", "header", "metadata", "one_channel", "raw_counts",
           "read_celsius"]  # fmt: skip


def header(path: Path, as_picture: bool = False) -> Header:
    """Return what a file says of its pixels, without decoding them. Raises SceneError naming the file."""
    with decoding(path, "an image", EXPORT), opened(regular_file(path)) as file:
        source = Source(path, file, as_picture)
        return next(one for one in FORMATS if one.fits(source)).header(source).checked(path)


def decode(path: Path, as_picture: bool = False) -> Decoded:
    """Decode a file, which is read once. Raises SceneError naming the file.

    as_picture: of a camera's JPEG, the picture that viewers show, not what was measured.
    """
    with decoding(path, "an image", EXPORT):
        source = Source(path, io.BytesIO(read_bytes(path)), as_picture)
        return next(one for one in FORMATS if one.fits(source)).decode(source)


@contextmanager
def metadata(path: Path) -> Iterator[tuple[Image.Exif, bytes]]:
    """Yield EXIF data and XMP of an image. Raises SceneError naming the file."""
    with decoding(path, "an image", EXPORT), opened(regular_file(path)) as file, pillow(Source(path, file)) as image:
        yield image.getexif(), image.info.get("xmp", b"")


def agreed_scale(path: Path, found: Header, given: CountScale) -> CountScale:
    """Return what counts mean: as the file states it, else `given`.

    Vue Pro's TIFF without TLinear states 0 (chuckaustin/devilsRiver 156557a). Raises SceneError if `given` contradicts
    the file, and for a gain that FLIR's manuals do not name unless `given` is known.
    """
    stated = found.scale
    is_named = stated.degC_per_count in TLINEAR_GAINS
    if not stated.is_known or (given.is_known and not is_named):
        return given
    if is_named and (not given.is_known or given == stated):
        return stated
    what = "which FLIR's manuals do not name: say" if not is_named else "counts × gain - 273.15 °C: leave out"
    raise SceneError(f"{path} states TlinearGain {stated.degC_per_count:g}, {what} degC_per_count and degC_at_zero")


def read_celsius(path: Path, scale: CountScale = NO_SCALE) -> np.ndarray:
    """Read temperatures (H, W) float64 in °C; NaN where there is none. Arguments and errors as of `celsius_of`."""
    return celsius_of(decode(path), path, scale)


def celsius_of(decoded: Decoded, path: Path, scale: CountScale = NO_SCALE) -> np.ndarray:
    """Return temperatures (H, W) float64 in °C of a decoded file; NaN where it holds none.

    Counts need a scale: of the file, or `scale`. Raises SceneError naming the file.
    """
    found, values = decoded.header, decoded.values
    if found.meaning == "shown":
        raise SceneError(
            f"{path} holds no temperatures: it is a picture ({found.format}, {found.depth}); use the camera's original "
            "file, or float TIFF in °C"
        )
    values = one_channel(decoded, path).astype(np.float64)
    if found.meaning == "counts":
        scale = agreed_scale(path, found, scale)
        if not scale.is_known:
            only = f", {found.remedy}, or" if found.remedy else ";"
            raise SceneError(
                f"{path} holds counts{only} say which temperature they mean: degC_per_count and degC_at_zero (in "
                "temperature.json, or as options)"
            )
        values = scale.degC(values)
    if decoded.valid is not None:
        values[~decoded.valid] = np.nan
    values[impossible(values)] = np.nan
    if np.isnan(values).all():
        raise SceneError(f"{path} holds no temperature between {TEMPERATURES[0]} and {TEMPERATURES[1]:g} °C")
    return values


def one_channel(decoded: Decoded, path: Path) -> np.ndarray:
    """Return values (H, W) of counts or °C. Raises SceneError for several channels that differ."""
    values = decoded.values
    if values.shape[2] > 1 and (values != values[..., :1]).any():
        raise SceneError(f"{path} is in colours of more than 8 bits; save counts in one channel, colours with 8 bits")
    return values[..., 0]


def raw_counts(values: np.ndarray, path: Path) -> np.ndarray:
    """Return counts whose temperature is not known. Raises SceneError for what a 16-bit camera cannot count."""
    if values.min() < 0 or values.max() > MOST_COUNTS:
        raise SceneError(f"{path} has values outside 0 to {MOST_COUNTS}; say what they mean: degC_per_count")
    return values

"""Thermal images from measured values: arrays and float images in °C, gray images of known range, radiometric files of
cameras, 16-bit images of raw counts.

Pixels that were not measured are masked (`fillers`); the others are scaled so that the range of the values is 0 to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.fillers import Fillers, find_apart, find_fillers, given_fillers, impossible
from tdgbench.scenes.formats import NO_SCALE, decode, one_channel, raw_counts, read_celsius
from tdgbench.scenes.options import ReadOptions
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import PERCENTILES, CountScale, robust_range, sampled
from tdgbench.scenes.view_images import (
    UNMEASURED,
    ImageSource,
    MaskedImage,
    ThermalImages,
    decide_channels,
    hidden_by,
    in_channels,
    resample,
)


@dataclass(frozen=True)
class Unit:
    """The unit of a scene's thermal values.

    steps: the range of the values is rounded to 1 / steps of the unit. dtype: in which values are scaled to [0, 1].
    """

    name: str
    steps: int
    dtype: type[np.floating] = np.float32


CELSIUS = Unit("°C", 100)
CELSIUS_OF_IMAGES = replace(CELSIUS, dtype=np.float64)
COUNTS = Unit("counts", 1)


LIKE_KELVIN = (233.0, 343.0)  # -40 to 70 °C: a whole scene so hot is none that people walk about


class Temperatures(NamedTuple):
    """Temperatures of a view in °C, or raw counts, as a file has them.

    values: (H, W) float32, not finite where nothing was measured. is_masked: whether its fillers are known and not
    finite; else they are searched for. block: side of the blocks (px) in which a filler spoils its neighbours.
    ends: whether the values end at the range of an image, so that measured ones may be equal to the lowest.
    """

    values: np.ndarray
    is_masked: bool = False
    block: int = 1
    ends: bool = False


Reader = Callable[[Path], Temperatures]


def read_counts(path: Path) -> Temperatures:
    """Read an image of raw counts, of 16 bits or more."""
    decoded = decode(path, as_picture=True)
    values = raw_counts(one_channel(decoded, path), path).astype(np.float32)
    if decoded.valid is not None:
        values[~decoded.valid] = np.nan
    return Temperatures(values)


def read_temperatures(path: Path, scale: CountScale = NO_SCALE) -> Temperatures:
    """Read an array, a float image or a camera's file: °C, or counts whose scale the file or `scale` states."""
    return Temperatures(read_celsius(path, scale).astype(np.float32))


def measured_images(
    sources: Mapping[str, ImageSource],
    read: Reader,
    train: list[str],
    options: ReadOptions,
    given: TemperatureRange | None,
    unit: Unit = CELSIUS,
) -> ThermalImages:
    """Read images of one channel, or of three equal ones. Raises SceneError.

    train: views whose values give the range, unless it is given.
    """
    channels = decide_channels(options.channels, are_gray=True)
    raw = {name: read(source.path) for name, source in sources.items()}
    known = {name for name, view in raw.items() if view.is_masked}
    fillers = _find_fillers(raw, known, unit) if options.fillers is None else given_fillers(options.fillers)
    measured, filled = {}, []
    for name, source in sources.items():
        view = raw.pop(name)
        invalid = impossible(view.values) if view.is_masked else fillers.mask(view.values, view.block)
        filled.append(invalid.mean())
        values, hidden = view.values[..., None], hidden_by(source, view.values[..., None])
        measured[name] = resample(values, invalid if hidden is None else invalid | hidden, source)
    span = given or _range_of({name: measured[name] for name in train}, sources, unit)
    images, clipped, count = {}, 0, 0
    for name in sources:
        values = _valid_values(measured[name])
        clipped += int(np.count_nonzero((values < span.min) | (values > span.max)))
        count += values.size
        images[name] = in_channels(_scaled(measured.pop(name), span, unit.dtype), channels)
    if clipped == count:
        folder = next(iter(sources.values())).path.parent
        raise SceneError(
            f"{folder}: no temperature lies between {span.min:g} and {span.max:g} °C; correct data.temperature or "
            "temperature.json"
        )
    notes = _about_fillers(fillers, filled, bool(known), unit)
    doubts = []
    if unit is not COUNTS and given is None and LIKE_KELVIN[0] < span.min and span.max < LIKE_KELVIN[1]:
        doubts = [f"temperatures of {span.min:g} to {span.max:g} °C look like kelvin; subtract 273.15, or ignore this"]
    assumed = {
        "values": "raw counts, of unknown °C" if unit is COUNTS else "°C",
        "range": _about_range(span, given, clipped / count, unit),
    }
    if unit is COUNTS:
        counts = round(span.min), round(span.max)
        return ThermalImages(images, channels, None, notes, raw_count_range=counts, assumed=assumed)
    return ThermalImages(images, channels, span, notes, assumed=assumed, doubts=doubts)


def _find_fillers(views: Mapping[str, Temperatures], known: set[str], unit: Unit) -> Fillers:
    values = {name: view.values for name, view in views.items()}
    if unit is COUNTS:
        return find_apart(values)
    fillers = find_fillers(values, known)
    if any(view.ends for view in views.values()):
        return replace(fillers, beyond=())  # black inside an image may be the coldest object
    return fillers


def _range_of(measured: Mapping[str, MaskedImage], sources: Mapping[str, ImageSource], unit: Unit) -> TemperatureRange:
    try:
        samples = (sampled(_valid_values(image), len(measured)).copy() for image in measured.values())
        return robust_range(samples, unit.steps)
    except ValueError as error:
        what = "raw counts" if unit is COUNTS else "temperatures"
        remedy = "export the images again" if unit is COUNTS else "set data.temperature=[min,max] in °C"
        raise SceneError(
            f"{next(iter(sources.values())).path.parent}: the {what} of the training views give no range "
            f"({error} {unit.name}); {remedy}"
        ) from error


def _valid_values(measured: MaskedImage) -> np.ndarray:
    """Return values (N,) of the valid pixels."""
    return measured.image.ravel() if measured.valid is None else measured.image[measured.valid].ravel()


def _scaled(measured: MaskedImage, span: TemperatureRange, dtype: type[np.floating]) -> MaskedImage:
    """Return the image in [0, 1], in place of the values."""
    image = measured.image.astype(dtype, copy=False)
    image -= dtype(span.min)
    image /= dtype(span.max - span.min)
    np.clip(image, 0, 1, out=image)
    image = image.astype(np.float32, copy=False)
    if measured.valid is not None:
        image[~measured.valid] = UNMEASURED
    return MaskedImage(image, measured.valid)


def _about_fillers(fillers: Fillers, filled: list[float], are_known: bool, unit: Unit) -> list[str]:
    """Return a note on masked pixels. filled: their share of each view. are_known: whether a reader has masked them."""
    if fillers.values:
        values = ", ".join(f"{value:g}" for value in fillers.values[:3]) + (" …" if len(fillers.values) > 3 else "")
        what = f"as not measured or filled with {values} {unit.name} (data.fillers=[] keeps them)"
    elif are_known:
        what = "as filler of the warp, darker than the image before it (data.fillers=[] keeps them, raised to that)"
    else:
        return [f"{np.mean(filled):.2%} of the pixels hold no temperature and are masked"] if any(filled) else []
    return [f"{np.mean(filled):.1%} of the pixels are masked, {what}"]


def _about_range(span: TemperatureRange, given: TemperatureRange | None, clipped: float, unit: Unit) -> str:
    origin = "" if given else f", {PERCENTILES[0]:g} and {PERCENTILES[1]:g} percentile of the training views"
    low, high = (f"{value:.0f}" if unit is COUNTS else f"{value:.2f}" for value in (span.min, span.max))
    return f"image values 0 and 1 are {low} and {high} {unit.name}{origin}; {clipped:.2%} of the pixels are clipped"

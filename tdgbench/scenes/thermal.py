"""Thermal images of a scene: as files show them, or scaled from measured values, °C or raw counts.

Pixels that were not measured are masked (`fillers`); the others are scaled so that the range of the values is 0 to 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.fillers import Fillers, find_apart, find_fillers, given_fillers, impossible
from tdgbench.scenes.formats import NO_SCALE, decode, header, one_channel, raw_counts, read_celsius
from tdgbench.scenes.options import ReadOptions
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import PERCENTILES, CountScale, Radiometry, check_range, sampled
from tdgbench.scenes.view_images import (
    UNMEASURED,
    ImageSource,
    MaskedImage,
    ThermalImages,
    hidden_by,
    in_channels,
    resample,
    shown_images,
)
from tdgbench.text import first_few

LIKE_KELVIN = 233.0  # K are -40 °C; a scene whose coldest point has more than 233 °C is none that people walk about
SCALED = " TIFF of TlinearGain"  # of 16-bit images that state their scale


class Unit(NamedTuple):
    """The unit of a scene's thermal values."""

    name: str
    what: str  # is measured
    means: str  # in words
    steps: int  # the range is rounded to 1 / steps
    digits: int  # of the range in words
    remedy: str  # for values without a range
    dtype: type[np.floating] = np.float32  # in which values are scaled to [0, 1]


CELSIUS = Unit("°C", "temperatures", "°C", 100, 2, "set data.temperature=[min,max] in °C")
CELSIUS_OF_IMAGES = CELSIUS._replace(dtype=np.float64)
COUNTS = Unit("counts", "raw counts", "raw counts, of unknown °C", 1, 0, "export the images again")


class Temperatures(NamedTuple):
    """Temperatures of a view in °C, or raw counts, as a file has them."""

    values: np.ndarray  # (H, W) float32, not finite where nothing was measured
    is_masked: bool = False  # whether its fillers are known and not finite; else they are searched for
    block: int = 1  # px, side of the blocks in which a filler spoils its neighbours
    ends: bool = False  # whether values end at the range of an image, so that measured ones may equal the lowest


Reader = Callable[[Path], Temperatures]


@dataclass(frozen=True)
class ThermalRequest:
    """Thermal images to read. scene: its name. train: views whose values give the range, unless radiometry has it."""

    scene: str
    sources: Mapping[str, ImageSource]  # by view name
    train: list[str]
    options: ReadOptions
    radiometry: Radiometry | None  # of the scene's files

    @property
    def folder(self) -> Path:
        """Folder of the first image, for messages."""
        return next(iter(self.sources.values())).path.parent

    @property
    def reader(self) -> Reader:
        """Reader of °C, or of counts whose scale the files or `radiometry` state."""
        return partial(read_temperatures, scale=NO_SCALE if self.radiometry is None else self.radiometry.scale)

    def with_range(self) -> ThermalRequest:
        """Return the request with data.temperature in its radiometry, if it is set. Raises SceneError."""
        if self.options.temperature is None:
            return self
        try:
            given = check_range(*self.options.temperature)
        except (ValueError, TypeError) as error:
            raise SceneError(f"data.temperature={list(self.options.temperature)}: {error}") from error
        scale = CountScale() if self.radiometry is None else self.radiometry.scale
        return replace(self, radiometry=Radiometry(given, scale))


def thermal_images(request: ThermalRequest) -> ThermalImages:
    """Read thermal images as `options.thermal` says. Raises SceneError.

    Shown float images hold °C, 16-bit ones of a known scale too; without a scale and a range, these are raw counts.
    """
    if request.options.thermal == "radiometric":
        return measured_images(request, request.reader)
    kinds, known = _kinds(request.sources), request.radiometry
    are_counts = [kind.startswith("16-bit") for kind in kinds]
    if known is not None and all(are_counts) and (known.scale.is_known or all(SCALED in kind for kind in kinds)):
        return measured_images(request, request.reader, CELSIUS_OF_IMAGES)
    if "float" not in kinds and (known is not None or not any(are_counts)):
        if request.options.fillers:
            raise SceneError(
                f"{request.folder}: data.fillers is in °C or raw counts, which these images do not hold; hide pixels "
                "by pictures in masks/"
            )
        return shown_images(request.sources, known, request.options.channels)
    if len(kinds) > 1:
        parts = ", ".join(f"{len(names)} {kind} ({first_few(names)})" for kind, names in sorted(kinds.items()))
        raise SceneError(
            f"{request.folder} holds images of several kinds: {parts}. Float images are in °C, 16-bit ones without a "
            "range raw counts, 8-bit ones neither; export all of them alike"
        )
    if "16-bit" in kinds:
        return measured_images(request, read_counts, COUNTS)
    return measured_images(request, request.reader, CELSIUS_OF_IMAGES)


def _kinds(sources: Mapping[str, ImageSource]) -> dict[str, list[str]]:
    """Return names of views by the depth of their images and, of counts, the scale that they state."""
    kinds: dict[str, list[str]] = {}
    for name, source in sources.items():
        found = source.header or header(source.path, as_picture=True)
        gain = f"{SCALED} {found.scale.degC_per_count:g}" if found.scale.is_known else ""
        kinds.setdefault(found.depth + gain, []).append(name)
    return kinds


def read_counts(path: Path) -> Temperatures:
    decoded = decode(path, as_picture=True)
    values = raw_counts(one_channel(decoded, path), path).astype(np.float32)
    if decoded.valid is not None:
        values[~decoded.valid] = np.nan
    return Temperatures(values)


def read_temperatures(path: Path, scale: CountScale = NO_SCALE) -> Temperatures:
    """Read an array, a float image or a camera's file: °C, or counts whose scale the file or `scale` states."""
    return Temperatures(read_celsius(path, scale).astype(np.float32))


def measured_images(request: ThermalRequest, read: Reader, unit: Unit = CELSIUS) -> ThermalImages:
    """Read images of one channel, or of three equal ones. Raises SceneError."""
    channels = 1 if request.options.channels == "auto" else request.options.channels
    measured, notes = _measured(request, read, unit)
    given = None if request.radiometry is None else request.radiometry.range
    span = given or _range_of([measured[name] for name in request.train], unit, request.folder)
    images, clipped, count = {}, 0, 0
    for name in request.sources:
        values = _valid_values(measured[name])
        clipped += int(np.count_nonzero((values < span.min) | (values > span.max)))
        count += values.size
        images[name] = in_channels(_scaled(measured.pop(name), span, unit.dtype), channels)
    if clipped == count:
        raise SceneError(
            f"{request.folder}: no temperature lies between {span.min:g} and {span.max:g} °C; correct data.temperature "
            "or temperature.json"
        )
    origin = "" if given else f", {PERCENTILES[0]:g} and {PERCENTILES[1]:g} percentile of the training views"
    ends = f"{span.min:.{unit.digits}f} and {span.max:.{unit.digits}f} {unit.name}{origin}"
    said = f"image values 0 and 1 are {ends}; {clipped / count:.2%} of the pixels are clipped"
    found = ThermalImages(images, channels, None, notes, assumed={"values": unit.means, "range": said})
    if unit is COUNTS:
        return replace(found, raw_count_range=(round(span.min), round(span.max)))
    doubts = [f"temperatures of {span.min:g} to {span.max:g} °C look like kelvin; subtract 273.15, or ignore this"]
    is_kelvin = given is None and span.min > LIKE_KELVIN
    return replace(found, temperature=span, doubts=doubts if is_kelvin else [])


def _measured(request: ThermalRequest, read: Reader, unit: Unit) -> tuple[dict[str, MaskedImage], list[str]]:
    """Return values (H, W, 1) of each view, resampled, with masked fillers, and notes on the fillers."""
    raw = {name: read(source.path) for name, source in request.sources.items()}
    known = {name for name, view in raw.items() if view.is_masked}
    given = request.options.fillers
    fillers = _find_fillers(raw, known, unit) if given is None else given_fillers(given)
    measured, filled = {}, []
    for name, source in request.sources.items():
        view = raw.pop(name)
        invalid = impossible(view.values) if view.is_masked else fillers.mask(view.values, view.block)
        filled.append(invalid.mean())
        values, hidden = view.values[..., None], hidden_by(source, view.values[..., None])
        measured[name] = resample(values, invalid if hidden is None else invalid | hidden, source)
    return measured, _about_fillers(fillers, filled, bool(known), unit)


def _find_fillers(views: Mapping[str, Temperatures], known: set[str], unit: Unit) -> Fillers:
    values = {name: view.values for name, view in views.items()}
    if unit is COUNTS:
        return find_apart(values)
    fillers = find_fillers(values, known)
    if any(view.ends for view in views.values()):
        return replace(fillers, beyond=())  # black inside an image may be the coldest object
    return fillers


def _range_of(measured: list[MaskedImage], unit: Unit, folder: Path) -> TemperatureRange:
    """Return the range between PERCENTILES of the values, widened to multiples of 1 / steps. Raises SceneError."""
    samples = [sampled(_valid_values(one), len(measured)).copy() for one in measured]
    low, high = map(float, np.percentile(np.concatenate(samples), PERCENTILES, method="nearest"))
    if low == high:
        what = f"the {unit.what} of the training views give no range (nearly all are {low:g} {unit.name})"
        raise SceneError(f"{folder}: {what}; {unit.remedy}")
    return TemperatureRange(math.floor(unit.steps * low) / unit.steps, math.ceil(unit.steps * high) / unit.steps)


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

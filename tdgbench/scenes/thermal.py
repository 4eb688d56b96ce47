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
from tdgbench.scenes.formats import NO_SCALE, celsius_of, decode, header, one_channel, raw_counts
from tdgbench.scenes.options import ReadOptions
from tdgbench.scenes.scene import PALETTE, TemperatureRange
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

RAW_IMAGES = "raw_images"  # of RGBT-Scenes: the cameras' radiometric files
LIKE_KELVIN = 233.0  # K are -40 °C; a scene whose coldest point has more than 233 °C is none that people walk about
LEAST_FILLED = 0.05  # of 0 to 65535; levels that a program stretches fill more, and counts of a camera less
MOST_SETTINGS = 3  # in what is assumed
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
    settings: str = ""  # of the camera, by which it computed them


Reader = Callable[[Path], Temperatures]


@dataclass(frozen=True)
class ThermalRequest:
    """Thermal images to read. scene: its name. train: views whose values give the range, unless it is stated."""

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
    def scale(self) -> CountScale:
        """What 16-bit counts mean, as `radiometry` states it."""
        return NO_SCALE if self.radiometry is None else self.radiometry.scale

    @property
    def reader(self) -> Reader:
        """Reader of °C, or of counts whose scale the files or `radiometry` state."""
        return partial(read_temperatures, scale=self.scale)

    @property
    def window(self) -> TemperatureRange | None:
        """The range of data.temperature, if it is set. Raises SceneError."""
        if self.options.temperature is None:
            return None
        try:
            return check_range(*self.options.temperature)
        except (ValueError, TypeError) as error:
            raise SceneError(f"data.temperature={list(self.options.temperature)}: {error}") from error


def thermal_images(request: ThermalRequest) -> ThermalImages:
    """Read thermal images as `options.thermal` says. Raises SceneError.

    Shown float images hold °C, 16-bit ones of a known scale too; without a scale and a range, these are raw counts.
    """
    if request.options.thermal == "radiometric":
        return measured_images(request, request.reader)
    kinds, window = _kinds(request.sources), request.window
    known = request.radiometry or (None if window is None else Radiometry(window))
    are_counts = [kind.startswith("16-bit") for kind in kinds]
    if known is not None and all(are_counts) and (known.scale.is_known or all(SCALED in kind for kind in kinds)):
        return measured_images(request, request.reader, CELSIUS_OF_IMAGES)
    if request.scale.is_known and not any(are_counts) and not (request.folder.parent / RAW_IMAGES).is_dir():
        raise SceneError(
            f"{request.folder} holds no 16-bit images, to which degC_per_count of temperature.json belongs; remove it"
        )
    without_scale = "16-bit" in kinds and not request.scale.is_known
    is_clear = len(kinds) == 1 or not without_scale
    if "float" not in kinds and is_clear and (known is not None or not any(are_counts)):
        if request.options.fillers:
            raise SceneError(
                f"{request.folder}: data.fillers is in °C or raw counts, which these images do not hold; hide pixels "
                "by pictures in masks/"
            )
        return _shown(request, known, without_scale)
    if len(kinds) > 1:
        parts = ", ".join(f"{len(names)} {kind} ({first_few(names)})" for kind, names in sorted(kinds.items()))
        raise SceneError(
            f"{request.folder} holds images of several kinds: {parts}. Float images are in °C, 16-bit ones without a "
            "scale raw counts, 8-bit ones neither; export all of them alike"
        )
    if "16-bit" in kinds:
        return measured_images(request, read_counts, COUNTS)
    return measured_images(request, request.reader, CELSIUS_OF_IMAGES)


def _shown(request: ThermalRequest, known: Radiometry | None, without_scale: bool) -> ThermalImages:
    """Read images as files show them; gray ones of a stated range in that of data.temperature. Raises SceneError."""
    found = shown_images(request.sources, known, request.options.channels)
    if known is None or found.assumed["values"] == PALETTE:
        return found
    stated, window = known.range, request.window or known.range
    low, high = _ends([found.images[name] for name in request.train]) if without_scale else (0, 1)
    if high - low < LEAST_FILLED:
        doubt = (
            f"16-bit values of the training views fill {high - low:.1%} of 0 to 65535, which are {stated.min:g} and "
            f"{stated.max:g} °C; if they are counts, state degC_per_count and degC_at_zero in temperature.json"
        )
        found = replace(found, doubts=[doubt])
    if window == stated:
        return found
    if window.max <= stated.min or window.min >= stated.max:
        raise _nothing_between(request, window)
    images, clipped, count = {}, 0, 0
    for name, view in found.images.items():
        scaled = view._replace(image=stated.min + (stated.max - stated.min) * view.image.astype(np.float64))
        degC = _valid_values(scaled)
        clipped += int(np.count_nonzero((degC < window.min) | (degC > window.max)))
        count += degC.size
        images[name] = _scaled(scaled, window, np.float64)
    ends = f"{window.min:g} and {window.max:g} °C (data.temperature)"
    said = f"gray, 0 and 1 are {ends}, of files that state {stated.min:g} to {stated.max:g} °C"
    shares = f"image values 0 and 1 are {ends}; {clipped / count:.2%} of the pixels are clipped"
    return replace(found, images=images, temperature=window, assumed={"values": said, "range": shares})


def _nothing_between(request: ThermalRequest, span: TemperatureRange) -> SceneError:
    return SceneError(
        f"{request.folder}: no temperature lies between {span.min:g} and {span.max:g} °C; correct data.temperature or "
        "temperature.json"
    )


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
    decoded = decode(path)
    return Temperatures(celsius_of(decoded, path, scale).astype(np.float32), settings=decoded.settings_in_words)


def measured_images(request: ThermalRequest, read: Reader, unit: Unit = CELSIUS) -> ThermalImages:
    """Read images of one channel, or of three equal ones. Raises SceneError."""
    channels = 1 if request.options.channels == "auto" else request.options.channels
    measured, notes, settings = _measured(request, read, unit)
    given = request.window or (None if request.radiometry is None else request.radiometry.range)
    span = given or _range_of([measured[name] for name in request.train], unit, request.folder)
    images, clipped, count = {}, 0, 0
    for name in request.sources:
        values = _valid_values(measured[name])
        clipped += int(np.count_nonzero((values < span.min) | (values > span.max)))
        count += values.size
        images[name] = in_channels(_scaled(measured.pop(name), span, unit.dtype), channels)
    if clipped == count:
        raise _nothing_between(request, span)
    origin = "" if given else f", {PERCENTILES[0]:g} and {PERCENTILES[1]:g} percentile of the training views"
    ends = f"{span.min:.{unit.digits}f} and {span.max:.{unit.digits}f} {unit.name}{origin}"
    said = f"image values 0 and 1 are {ends}; {clipped / count:.2%} of the pixels are clipped"
    assumed = {"values": unit.means, "range": said}
    if unit is COUNTS:
        return ThermalImages(images, channels, None, notes, (round(span.min), round(span.max)), assumed)
    doubts = [] if given else _doubts_of_range(span)
    if settings:
        assumed["settings"] = "; ".join([*settings][:MOST_SETTINGS])
    if len(settings) > 1:
        first, other, *_ = settings.values()
        doubts.append(
            f"the camera's settings differ between views ({len(settings)} sets; {first} and {other}), and temperatures "
            "with them; set them alike in the files, by the camera's program"
        )
    return ThermalImages(images, channels, span, notes, None, assumed, doubts)


def _doubts_of_range(span: TemperatureRange) -> list[str]:
    """Return why temperatures in a range that nobody has stated may be none."""
    what = f"temperatures of {span.min:g} to {span.max:g} °C look like"
    if span.min > LIKE_KELVIN:
        return [f"{what} kelvin; subtract 273.15, or ignore this"]
    if span.min >= 0 and span.max <= 1:
        return [f"{what} shares of a range; export the images again in °C, or ignore this"]
    return []


def _measured(
    request: ThermalRequest, read: Reader, unit: Unit
) -> tuple[dict[str, MaskedImage], list[str], dict[str, str]]:
    """Return values (H, W, 1) of each view, resampled, with masked fillers, notes on these, and views by settings."""
    raw = {name: read(source.path) for name, source in request.sources.items()}
    settings = {view.settings: name for name, view in raw.items() if view.settings}
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
    return measured, _about_fillers(fillers, filled, bool(known), unit), settings


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
    low, high = _ends(measured)
    if low == high:
        what = f"the {unit.what} of the training views give no range (nearly all are {low:g} {unit.name})"
        raise SceneError(f"{folder}: {what}; {unit.remedy}")
    return TemperatureRange(math.floor(unit.steps * low) / unit.steps, math.ceil(unit.steps * high) / unit.steps)


def _ends(measured: list[MaskedImage]) -> tuple[float, float]:
    """Return the PERCENTILES of the valid values."""
    samples = [sampled(_valid_values(one), len(measured)).copy() for one in measured]
    low, high = np.percentile(np.concatenate(samples), PERCENTILES, method="nearest")
    return float(low), float(high)


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

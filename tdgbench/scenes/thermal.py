"""Thermal images of a scene, from what its layout found and what the options say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import NO_SCALE, header
from tdgbench.scenes.layouts import SceneFiles
from tdgbench.scenes.measured import CELSIUS_OF_IMAGES, COUNTS, measured_images, read_counts, read_temperatures
from tdgbench.scenes.options import ReadOptions
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import Radiometry, check_range
from tdgbench.scenes.view_images import ImageSource, ThermalImages, shown_images
from tdgbench.scenes.warped import WarpedPictures, is_picture
from tdgbench.text import first_few


def thermal_images(
    scene_files: SceneFiles,
    sources: Mapping[str, ImageSource],
    train: list[str],
    options: ReadOptions,
    published: TemperatureRange | None,
) -> ThermalImages:
    """Read the thermal images of a scene. Raises SceneError.

    train: views whose temperatures give the range, unless it is known. published: °C of black and white in gray images
    of this scene, used if neither the options nor the scene's files say it.
    """
    radiometry = scene_files.radiometry
    if options.temperature is not None:
        try:
            given = check_range(*options.temperature)
        except (ValueError, TypeError) as error:
            raise SceneError(f"data.temperature={list(options.temperature)}: {error}") from error
        radiometry = Radiometry(given) if radiometry is None else replace(radiometry, range=given)
    pictures = [name for name, source in sources.items() if is_picture(source.path)]
    if scene_files.in_celsius and pictures:
        return _of_pictures(scene_files, sources, pictures, train, options, radiometry, published)
    if scene_files.in_celsius or options.thermal == "radiometric":
        reader = partial(read_temperatures, scale=NO_SCALE if radiometry is None else radiometry.scale)
        return measured_images(sources, reader, train, options, None if radiometry is None else radiometry.range)
    return _of_images(sources, train, options, radiometry)


def _of_images(
    sources: Mapping[str, ImageSource], train: list[str], options: ReadOptions, radiometry: Radiometry | None
) -> ThermalImages:
    """Read thermal images as their files show them; float images hold °C, 16-bit ones without a range raw counts."""
    stored: dict[str, list[str]] = {}
    for name, source in sources.items():
        found = source.header or header(source.path, as_picture=True)
        gain = f" TIFF of TlinearGain {found.scale.degC_per_count:g}" if found.scale.is_known else ""
        stored.setdefault(found.depth + gain, []).append(name)
    hold_counts = radiometry is None and any(kind.startswith("16-bit") for kind in stored)
    if len(stored) > 1 and ("float" in stored or hold_counts):
        parts = ", ".join(f"{len(names)} {kind} ({first_few(names)})" for kind, names in sorted(stored.items()))
        raise SceneError(
            f"{next(iter(sources.values())).path.parent} holds images of several kinds: {parts}. Float images "
            "are in °C, 16-bit ones without a range raw counts, 8-bit ones neither; export all of them alike"
        )
    if "float" in stored or (hold_counts and "16-bit" not in stored):
        given = None if radiometry is None else radiometry.range
        return measured_images(sources, read_temperatures, train, options, given, CELSIUS_OF_IMAGES)
    if hold_counts:
        return measured_images(sources, read_counts, train, options, None, COUNTS)
    return shown_images(sources, radiometry, options.channels)


def _of_pictures(
    files: SceneFiles,
    sources: Mapping[str, ImageSource],
    pictures: list[str],
    train: list[str],
    options: ReadOptions,
    radiometry: Radiometry | None,
    published: TemperatureRange | None,
) -> ThermalImages:
    """Read thermal images from gray images of temperatures; views that are not in `pictures` have arrays."""
    notes, how = [], "gray, of known °C"
    if radiometry is None:
        if published is None:
            raise SceneError(
                f"{sources[pictures[0]].path.parent} holds gray images, and no temperatures of black and white are "
                "published for a scene of this name; set data.temperature=[min,max] in °C, or add temperature.json"
            )
        how = f"gray; black and white are {published.min:g} and {published.max:g} °C, as published"
        radiometry = Radiometry(published)
    if len(pictures) < len(sources):
        arrays = len(sources) - len(pictures)
        notes.append(f"{arrays} views are read from arrays, {len(pictures)} from gray images: {first_few(pictures)}")
    alone = [name for name in pictures if name not in files.unwarped]
    if alone and options.fillers is None:
        notes.append(
            f"{len(alone)} gray images have none from before the warp; only constant fillers are found: "
            f"{first_few(alone)}"
        )
    reader = WarpedPictures(radiometry, files.unwarped, options.fillers is None)
    images = measured_images(sources, reader, train, options, radiometry.range)
    return replace(images, notes=[*notes, *images.notes], assumed={**images.assumed, "values": how})

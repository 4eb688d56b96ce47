"""Read all camera files of a capture, and store their content until the scene is written."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Container, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image
from skimage.exposure import equalize_adapthist

from tdgbench.data.prepare.dji import JPEG, RAW, check_unit, converted_with, read_raw
from tdgbench.data.prepare.places import GPS, Taken, read_taken
from tdgbench.data.prepare.report import FileReport, Report
from tdgbench.data.prepare.resample import Size
from tdgbench.data.prepare.sources import Sources, ViewFiles
from tdgbench.data.progress import step
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import Decoded, PhotoMapping, agreed_scale, celsius_of, decode, header
from tdgbench.scenes.images import read_image, unit_image, with_channels
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.temperature import FILE, CountScale, read_radiometry

TAILS = 0.5, 99.5  # percentiles of a thermal image that become black and white in its picture for COLMAP
NEARLY_ALL = 0.8  # of the views: others, of another kind, are left out; with fewer, nobody knows what is meant
MOST_SAID = 8  # of what files state, and what is assumed about them
CLIP_LIMIT = 0.02  # of CLAHE, as a share of a tile's pixels


class Kind(NamedTuple):
    """What the files of all views of one scene must have in common. Sizes are (width, height) in px.

    rgb: of the images that COLMAP sees; of thermal images alone, theirs.
    """

    rgb: Size
    thermal: Size
    is_celsius: bool
    is_one_file: bool  # the RGB image is the photo inside the thermal file
    is_thermal_alone: bool = False
    camera: str = ""  # as the thermal file's EXIF data name it
    counts: str = ""  # how the thermal file holds them; empty of other values

    def __str__(self) -> str:
        sizes = f"{self.thermal[0]}×{self.thermal[1]}"
        if not self.is_thermal_alone:
            sizes = f"RGB {self.rgb[0]}×{self.rgb[1]} and thermal {sizes}"
        by = f" by {self.camera}" if self.camera else ""
        by += f", counts of {self.counts}" if self.counts else ""
        return sizes + by + ("" if self.is_celsius else " without temperatures") + (" in one file" * self.is_one_file)


@dataclass(frozen=True)
class ViewContent:
    """Content of a view's files.

    thermal: (H, W) float64 °C with NaN where invalid; or (H, W, C) float32 in [0, 1] of shown images. rgb: (h, w, 3)
    float32 in [0, 1], if it is looked for. mapping: as a FLIR file states it, of its own photo. counts: as of Kind.
    settings: of the camera, in words. assumed: about the files.
    """

    thermal: np.ndarray
    rgb: np.ndarray | None
    taken: Taken
    mapping: PhotoMapping | None = None
    counts: str = ""
    settings: str = ""
    assumed: Sequence[str] = ()

    def kind(self, is_one_file: bool) -> Kind:
        thermal = self.thermal.shape[1::-1]
        rgb = thermal if self.rgb is None else self.rgb.shape[1::-1]
        return Kind(rgb, thermal, self.thermal.ndim == 2, is_one_file, self.rgb is None, self.taken.camera, self.counts)


@dataclass
class Capture:
    """Views of one kind, whose images wait in a folder. names: image file by view.

    mappings: where thermal images lie in the photos inside their files, by view, where the files state it. places: of
    the pictures that COLMAP sees, and heights above where a drone took off in m, by view, where the files state them.
    """

    folder: Path
    kind: Kind
    names: dict[str, str] = field(default_factory=dict)
    mappings: dict[str, PhotoMapping] = field(default_factory=dict)
    places: dict[str, GPS] = field(default_factory=dict)
    heights: dict[str, float] = field(default_factory=dict)

    def rgb(self, view: str) -> np.ndarray | None:
        """Return the RGB image (h, w, 3), float32 in [0, 1], if there is one."""
        return None if self.kind.is_thermal_alone else with_channels(read_image(self.folder / self.names[view]), 3)

    def keep(self, views: Container[str]) -> None:
        """Forget all other views, whose files stay in the folder."""
        facts: tuple[dict[str, Any], ...] = (self.names, self.places, self.heights, self.mappings)
        for by_view in facts:
            for view in [view for view in by_view if view not in views]:
                del by_view[view]

    def thermal(self, view: str) -> np.ndarray:
        """Return the thermal image, (H, W) in °C or (H, W, C) in [0, 1]."""
        return np.load(self.folder / f"{self.names[view]}.npy", allow_pickle=False)


def read_capture(
    folder: Path, work: Path, sources: Sources, scale: CountScale, thermal_alone: bool, report: Report
) -> Capture:
    """Read all files that were found in a folder, and store their content in `work`.

    scale: of 16-bit counts; where it is not known, the folder's temperature.json says it. thermal_alone: RGB images are
    not looked for. Files that cannot be read are reported. Raises SceneError if none can, and for views of several
    kinds.
    """
    report.files += [FileReport(str(p), "", p.stem, "left out", why) for p, why in sources.left_out.items()]
    report.assumptions += sources.notes
    radiometry = read_radiometry(folder / FILE)
    if not scale.is_known and radiometry is not None:
        scale = radiometry.scale
    capture = Capture(work, Kind((0, 0), (0, 0), False, False))
    kinds: dict[Kind, list[FileReport]] = {}
    stated: dict[str, tuple[str, ...]] = {}  # by the files, by view
    with step("files to read", len(sources.views)) as count:
        for index, files in enumerate(sources.views):
            rgb = "" if thermal_alone else "inside" if files.rgb is None else str(files.rgb)
            origin = "" if files.origin is None else str(files.origin)
            entry = FileReport(str(files.thermal), rgb, files.view, "written", origin=origin)
            report.files.append(entry)
            try:
                content = read_view(files, scale, thermal_alone)
            except SceneError as error:
                entry.status, entry.reason = "not read", str(error)
            else:
                _store(capture, files, content, index)
                kinds.setdefault(content.kind(files.rgb is None and not thermal_alone), []).append(entry)
                settings = f"temperatures are the object's, as set in the camera or its converter: {content.settings}"
                stated[files.view] = *([settings] if content.settings else []), *content.assumed
            count(index + 1)
    if not kinds:
        raise too_few(folder, 0, report)
    capture.kind = _main_kind(folder, kinds)
    capture.keep({entry.view for entry in kinds[capture.kind]})
    for kind in kinds.keys() - {capture.kind}:
        for entry in kinds[kind]:
            entry.status, entry.reason = "left out", f"is {kind}, and the others are {capture.kind}"
    report.rgb_size = None if thermal_alone else capture.kind.rgb
    report.thermal_size = capture.kind.thermal
    if not capture.kind.is_celsius:
        known = f"whose °C {folder / FILE} gives"
        if not is_there(folder / FILE):
            known = "without °C: errors need --degC-per-count, a temperature.json or a converter (docs/data.md)"
        report.assumptions.append(f"thermal images show values {known}")
    said = Counter(words for view in capture.names for words in stated[view])
    report.assumptions += [
        words + (f" ({number} of {len(capture.names)} views)" if number < len(capture.names) else "")
        for words, number in said.most_common(MOST_SAID)
    ]
    return capture


def _main_kind(folder: Path, kinds: dict[Kind, list[FileReport]]) -> Kind:
    """Return the kind of all views, or of nearly all of them. Raises SceneError if there is none."""
    ranked = sorted(kinds.items(), key=lambda item: -len(item[1]))
    if len(ranked[0][1]) < NEARLY_ALL * sum(map(len, kinds.values())):
        described = [f"{len(views)} with {kind} ({views[0].view} …)" for kind, views in ranked]
        raise SceneError(
            f"{folder} holds views of different cameras or settings: {'; '.join(described[:4])}. One scene is of one "
            "camera, or pair of them, in one orientation: prepare each kind from a folder of its own, or name its "
            "files by --pairs"
        )
    return ranked[0][0]


def read_view(files: ViewFiles, scale: CountScale, thermal_alone: bool = False) -> ViewContent:
    """Read a view's files. Counts without a scale stay counts in thermal images alone. Raises SceneError."""
    path = check_unit(files.thermal)
    decoded = read_raw(path, files.origin) if path.suffix.lower() == RAW else decode(path)
    found, rgb, mapping, assumed = decoded.header, None, None, [*decoded.header.assumed]
    if files.rgb is not None:
        rgb = with_channels(read_image(files.rgb), 3)
        assumed += [f"RGB: {words}" for words in header(files.rgb, as_picture=True).assumed]
    elif not thermal_alone and decoded.photo is None:
        raise SceneError(
            f"{path} holds no photo{decoded.lost and f' ({decoded.lost})'}: put an RGB image of the same name beside "
            "it, or name both by --pairs, or find poses in thermal images alone, by --sfm thermal"
        )
    elif not thermal_alone and decoded.photo is not None:
        rgb, mapping = decoded.photo.astype(np.float32) / 255, decoded.mapping
    own = agreed_scale(path, found, scale) if found.meaning == "counts" else scale
    may_be_shown = thermal_alone or found.format == "PNG"
    if found.meaning == "°C" or (found.meaning == "counts" and (own.is_known or not may_be_shown)):
        thermal = celsius_of(decoded, path, scale)
    else:
        thermal = unit_image(decoded, path)
        if decoded.valid is not None:
            thermal[~decoded.valid] = np.nan
    assumed += [decoded.lost] if decoded.lost else []
    counts = found.format if found.meaning == "counts" else ""
    return ViewContent(thermal, rgb, _taken(files), mapping, counts, _settings(decoded, path, own, scale), assumed)


def _taken(files: ViewFiles) -> Taken:
    """Return how a view was taken: position as of the RGB image, if it has one; the camera is the thermal one."""
    stated = [read_taken(path) for path in (files.rgb, files.origin, files.thermal) if path is not None]
    gps = next((one.gps for one in stated if one.gps is not None), None)
    height = next((one.height for one in stated if one.height is not None), None)
    return Taken(gps, height, next((one.camera for one in stated[::-1] if one.camera), ""))


def write_pictures(capture: Capture) -> None:
    """Write a gray picture of each thermal image for COLMAP, in which it finds features; for captures without RGB."""
    with step("pictures to write", len(capture.names)) as count:
        for index, (view, name) in enumerate(capture.names.items()):
            Image.fromarray(picture(capture.thermal(view))).save(capture.folder / name)
            count(index + 1)


def picture(thermal: np.ndarray) -> np.ndarray:
    """Return gray levels (H, W) uint8 of a thermal image (H, W) or (H, W, C): its own range, then CLAHE.

    Invalid pixels (NaN) become black.
    """
    gray = thermal if thermal.ndim == 2 else thermal.mean(axis=2)
    low, high = np.nanpercentile(gray, TAILS)
    stretched = np.nan_to_num(np.clip((gray - low) / max(high - low, 1e-12), 0, 1))
    return np.round(255 * equalize_adapthist(stretched, clip_limit=CLIP_LIMIT)).astype(np.uint8)


def too_few(folder: Path, count: int, report: Report) -> SceneError:
    """Return the error of a folder with too few views for a scene."""
    reasons = report.reasons()
    return SceneError(
        f"{folder} holds {count} usable pictures; structure from motion needs 3, and a good scene 30 or more. "
        + (f"Others are of no use: {reasons}" if reasons else "Take more, or extract temperatures alone with --no-sfm")
    )


def _store(capture: Capture, files: ViewFiles, content: ViewContent, index: int) -> None:
    """Store a view's images in the folder. COLMAP reads focal lengths from the EXIF data of JPEG files."""
    is_jpeg = files.rgb is not None and files.rgb.suffix.lower() in JPEG
    name = f"{index:06d}{'.jpg' if is_jpeg else '.png'}"  # without spaces, which lists of pairs cannot have
    if is_jpeg and files.rgb is not None:
        shutil.copyfile(files.rgb, capture.folder / name)
    elif content.rgb is not None:
        Image.fromarray(np.round(content.rgb * 255).astype(np.uint8)).save(capture.folder / name)
    np.save(capture.folder / f"{name}.npy", content.thermal.astype(np.float32))
    capture.names[files.view] = name
    if content.taken.gps is not None:
        capture.places[files.view] = content.taken.gps
    if content.taken.height is not None:
        capture.heights[files.view] = content.taken.height
    if content.mapping is not None:
        capture.mappings[files.view] = content.mapping


def _settings(decoded: Decoded, path: Path, own: CountScale, given: CountScale) -> str:
    """Say what a file itself states of its temperatures: FLIR's settings, a converter's, or TLinear."""
    settings = decoded.settings
    if settings:
        return (
            f"emissivity {settings['emissivity']:.2f}, distance {settings['object_distance']:g} m, reflected "
            f"{settings['reflected_apparent_temperature'] - 273.15:.1f} °C, window transmission "
            f"{settings['ir_window_transmission']:.2f}"
        )
    return f"TLinear, °C = counts × {own.degC_per_count:g} - 273.15" if own != given else converted_with(path)

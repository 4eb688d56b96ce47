"""Read all camera files of a capture, and store their content until the scene is written."""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image
from skimage.exposure import equalize_adapthist

from tdgbench.data.prepare.dji import RAW, check_unit, converted_with, read_raw
from tdgbench.data.prepare.places import Taken, read_taken
from tdgbench.data.prepare.report import FileReport, Report
from tdgbench.data.prepare.resample import Size
from tdgbench.data.prepare.sources import Sources, ViewFiles
from tdgbench.data.progress import step
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import Decoded, PhotoMapping, agreed_scale, celsius_of, decode, header
from tdgbench.scenes.formats.pictures import JPEG
from tdgbench.scenes.images import read_image, thermal_image, with_channels
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.temperature import CountScale, read_radiometry, temperature_file

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


class ViewContent(NamedTuple):
    """Content of a view's files.

    thermal: (H, W) float64 °C with NaN where invalid; or (H, W, C) float32 in [0, 1] of shown images. rgb: (h, w, 3)
    float32 in [0, 1], if it is looked for. mapping: where the thermal image lies in the photo inside a FLIR file.
    assumed: about the files, with what they state of their temperatures.
    """

    kind: Kind
    thermal: np.ndarray
    rgb: np.ndarray | None
    taken: Taken
    mapping: PhotoMapping | None
    assumed: Sequence[str]


class CapturedView(NamedTuple):
    """A view of a capture, as `ViewContent`. image: file of the picture that COLMAP sees, in the capture's folder."""

    image: str
    taken: Taken
    mapping: PhotoMapping | None = None


@dataclass
class Capture:
    """Views of one kind by name, whose images wait in a folder."""

    folder: Path
    kind: Kind
    views: dict[str, CapturedView] = field(default_factory=dict)

    def rgb(self, view: str) -> np.ndarray | None:
        """Return the RGB image (h, w, 3), float32 in [0, 1], if there is one."""
        path = self.folder / self.views[view].image
        return None if self.kind.is_thermal_alone else with_channels(read_image(path), 3)

    def thermal(self, view: str) -> np.ndarray:
        """Return the thermal image, (H, W) in °C or (H, W, C) in [0, 1]."""
        return np.load(self.folder / f"{self.views[view].image}.npy", allow_pickle=False)

    def keep(self, names: Container[str]) -> None:
        """Forget all other views, whose files stay in the folder."""
        self.views = {name: view for name, view in self.views.items() if name in names}


def read_capture(
    folder: Path, work: Path, sources: Sources, scale: CountScale, thermal_alone: bool, report: Report
) -> Capture:
    """Read all files that were found in a folder, and store their content in `work`.

    scale: of 16-bit counts; where it is not known, the folder's `temperature_file` says it. thermal_alone: RGB images
    are not looked for. Files that cannot be read are reported. Raises SceneError if none can, and for views of several
    kinds.
    """
    report.files += [FileReport(str(p), "", p.stem, "left out", why) for p, why in sources.left_out.items()]
    report.assumptions += sources.notes
    radiometry = read_radiometry(temperature_file(folder))
    said = "--degC-per-count"
    if not scale.is_known and radiometry is not None:
        scale, said = radiometry.scale, f"degC_per_count of {temperature_file(folder)}"
    capture = Capture(work, Kind((0, 0), (0, 0), False, False))
    kinds: dict[Kind, list[FileReport]] = {}
    assumed: dict[str, Sequence[str]] = {}  # by view
    with step("files to read", len(sources.views)) as count:
        for index, files in enumerate(sources.views):
            rgb, origin = "" if thermal_alone else str(files.rgb or "inside"), str(files.origin or "")
            entry = FileReport(str(files.thermal), rgb, files.view, "written", origin=origin)
            report.files.append(entry)
            try:
                content = read_view(files, scale, thermal_alone)
            except SceneError as error:
                entry.drop("not read", str(error))
            else:
                _store(capture, files, content, index)
                kinds.setdefault(content.kind, []).append(entry)
                assumed[files.view] = content.assumed
            count(index + 1)
    if not kinds:
        raise too_few(folder, 0, report)
    if scale.is_known and not any(kind.counts for kind in kinds):
        raise SceneError(f"{folder} holds no files of counts, to which {said} belongs; leave it out")
    _keep_main_kind(folder, capture, kinds, report)
    report.rgb_size = None if thermal_alone else capture.kind.rgb
    report.thermal_size = capture.kind.thermal
    report.assumptions += _assumed(folder, capture, assumed)
    return capture


def _keep_main_kind(folder: Path, capture: Capture, kinds: dict[Kind, list[FileReport]], report: Report) -> None:
    """Keep the views of one kind, which are all or nearly all of them. Raises SceneError if no kind is."""
    ranked = sorted(kinds.items(), key=lambda item: -len(item[1]))
    capture.kind, views = ranked[0]
    if len(views) < NEARLY_ALL * sum(map(len, kinds.values())):
        described = [f"{len(views)} with {kind} ({views[0].view} …)" for kind, views in ranked]
        unread = [one for one in report.files if one.status == "not read"]
        lost = f". {len(unread)} more cannot be read; the first: {unread[0].reason}" if unread else ""
        raise SceneError(
            f"{folder} holds views of different cameras or settings: {'; '.join(described[:4])}. One scene is of one "
            "camera, or pair of them, in one orientation: prepare each kind from a folder of its own, or name its "
            f"files by --pairs{lost}"
        )
    capture.keep({entry.view for entry in views})
    for kind, others in ranked[1:]:
        for entry in others:
            entry.drop("left out", f"is {kind}, and the others are {capture.kind}")


def _assumed(folder: Path, capture: Capture, by_view: Mapping[str, Sequence[str]]) -> list[str]:
    """Return what is assumed about the files, each line once, with the number of views."""
    said = []
    if not capture.kind.is_celsius:
        stated = temperature_file(folder)
        known = f"whose °C {stated} gives"
        if not is_there(stated):
            known = "without °C: errors need --degC-per-count, a temperature.json or a converter (docs/data.md)"
        said.append(f"thermal images show values {known}")
    views = len(capture.views)
    for words, number in Counter(line for view in capture.views for line in by_view[view]).most_common(MOST_SAID):
        said.append(words if number == views else f"{words} ({number} of {views} views)")
    return said


def read_view(files: ViewFiles, scale: CountScale, thermal_alone: bool = False) -> ViewContent:
    """Read a view's files. Counts without a scale stay counts in thermal images alone. Raises SceneError."""
    path = check_unit(files.thermal)
    decoded = read_raw(path, files.origin) if path.suffix.lower() == RAW else decode(path)
    rgb, mapping = (None, None) if thermal_alone else _photo(files, decoded)
    has_counts = decoded.header.meaning == "counts"
    own = agreed_scale(path, decoded.header, scale) if has_counts else scale
    may_be_shown = thermal_alone or decoded.header.may_be_shown
    is_celsius = decoded.header.meaning == "°C" or (has_counts and (own.is_known or not may_be_shown))
    thermal, chroma = (celsius_of(decoded, path, scale), "") if is_celsius else thermal_image(decoded, path)
    if not is_celsius and decoded.valid is not None:
        thermal[~decoded.valid] = np.nan
    taken, size = _taken(files), thermal.shape[1::-1]
    kind = Kind(
        size if rgb is None else rgb.shape[1::-1], size, thermal.ndim == 2, rgb is not None and files.rgb is None,
        thermal_alone, taken.camera, decoded.header.format if has_counts else "",
    )  # fmt: skip
    said = [*_stated(decoded, files, own, scale), chroma]
    return ViewContent(kind, thermal, rgb, taken, mapping, [line for line in said if line])


def _stated(decoded: Decoded, files: ViewFiles, own: CountScale, given: CountScale) -> list[str]:
    """Return what files state, as FLIR's settings, a converter's, or TLinear, and what is assumed about them."""
    rgb = [] if files.rgb is None else header(files.rgb, as_picture=True).assumed
    settings = decoded.settings_in_words or converted_with(files.thermal)
    if own != given:
        settings = f"TLinear, °C = counts × {own.degC_per_count:g} - 273.15"
    lines = [
        f"temperatures are the object's, as set in the camera or its converter: {settings}" if settings else "",
        *decoded.header.assumed, *(f"RGB: {words}" for words in rgb), decoded.lost,
    ]  # fmt: skip
    if decoded.header.meaning == "counts" and own == given and given.is_known:
        zero = f"{'-' if given.degC_at_zero < 0 else '+'} {abs(given.degC_at_zero):g}"
        lines.append(f"°C = counts × {given.degC_per_count:g} {zero}, as --degC-per-count or the folder's file says")
    return lines


def _photo(files: ViewFiles, decoded: Decoded) -> tuple[np.ndarray, PhotoMapping | None]:
    """Return the RGB image of a view, and where the thermal one lies in a photo inside its file. Raises SceneError."""
    if files.rgb is not None:
        return with_channels(read_image(files.rgb), 3), None
    if decoded.photo is None:
        raise SceneError(
            f"{files.thermal} holds no photo{decoded.lost and f' ({decoded.lost})'}: put an RGB image of the same name "
            "beside it, or name both by --pairs, or find poses in thermal images alone, by --sfm thermal"
        )
    return decoded.photo.astype(np.float32) / 255, decoded.mapping


def _taken(files: ViewFiles) -> Taken:
    """Return how a view was taken: position as of the RGB image, if it has one; the camera is the thermal one."""
    stated = [read_taken(path) for path in (files.rgb, files.origin, files.thermal) if path is not None]
    gps = next((one.gps for one in stated if one.gps is not None), None)
    height = next((one.height for one in stated if one.height is not None), None)
    return Taken(gps, height, next((one.camera for one in stated[::-1] if one.camera), ""))


def write_pictures(capture: Capture) -> None:
    """Write a gray picture of each thermal image for COLMAP, in which it finds features; for captures without RGB."""
    with step("pictures to write", len(capture.views)) as count:
        for index, (name, view) in enumerate(capture.views.items()):
            Image.fromarray(picture(capture.thermal(name))).save(capture.folder / view.image)
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
    capture.views[files.view] = CapturedView(name, content.taken, content.mapping)

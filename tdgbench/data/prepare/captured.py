"""Read all files of a folder of camera files, and store what they hold until the scene is written."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from tdgbench.data.prepare.extract import CountScale, Extracted, count_scale, extract, read_rgb
from tdgbench.data.prepare.mapping import Size
from tdgbench.data.prepare.report import FileReport, Report
from tdgbench.data.prepare.sources import ViewFiles, find_sources
from tdgbench.data.progress import step
from tdgbench.scenes import SceneError
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.radiometric import PhotoMapping
from tdgbench.scenes.temperature import FILE, read_radiometry


@dataclass
class Captured:
    """Views, whose images wait in a folder. names: image file by view.

    mappings: where thermal images lie in the photos inside their files, by view, where the files state it.
    """

    folder: Path
    names: dict[str, str] = field(default_factory=dict)
    mappings: dict[str, PhotoMapping] = field(default_factory=dict)
    rgb_size: Size = (0, 0)
    thermal_size: Size = (0, 0)
    is_celsius: bool = False

    def rgb(self, view: str) -> np.ndarray:
        """RGB image (h, w, 3) float32 in [0, 1]."""
        return read_rgb(self.folder / self.names[view])

    def thermal(self, view: str) -> np.ndarray:
        """Thermal image (H, W) in °C, or (H, W, C) in [0, 1]."""
        return np.load(self.folder / f"{self.names[view]}.npy", allow_pickle=False)


def capture(folder: Path, work: Path, pairs: tuple[str, str] | None, counts: CountScale, report: Report) -> Captured:
    """Read all files, and store their content in `work`.

    Files that cannot be read are reported. Raises SceneError if none can, and for sizes that differ.
    """
    sources = find_sources(folder, pairs)
    report.files += [FileReport(str(p), "", p.stem, "left out", why) for p, why in sources.left_out.items()]
    scale = count_scale(counts, read_radiometry(folder / FILE))
    captured = Captured(work)
    kinds: dict[tuple[Size, Size, bool, bool], list[str]] = {}
    settings: dict[str, int] = {}
    with step("files to read", len(sources.views)) as count:
        for index, files in enumerate(sources.views):
            rgb = "inside" if files.rgb is None else str(files.rgb)
            entry = FileReport(str(files.thermal), rgb, files.view, "written")
            report.files.append(entry)
            try:
                content = extract(files, scale)
            except SceneError as error:
                entry.status, entry.reason = "not read", str(error)
            else:
                _store(captured, files, content, index)
                kinds.setdefault((*content.sizes, content.is_celsius, files.rgb is None), []).append(files.view)
                settings[content.settings] = settings.get(content.settings, 0) + 1
            count(index + 1)
    if not kinds:
        raise too_few(folder, 0, report)
    if len(kinds) > 1:
        raise SceneError(_mixed(folder, kinds))
    (captured.rgb_size, captured.thermal_size, captured.is_celsius, _) = next(iter(kinds))
    report.rgb_size, report.thermal_size = captured.rgb_size, captured.thermal_size
    report.assumptions += _about_temperatures(folder, captured.is_celsius, settings)
    return captured


def too_few(folder: Path, count: int, report: Report) -> SceneError:
    """Return the error of a folder with too few views for a scene."""
    reasons = "; ".join(file.reason for file in report.files if file.reason)[:400]
    return SceneError(
        f"{folder} holds {count} usable pictures; structure from motion needs 3, and a good scene 30 or more. "
        "Take more, or extract temperatures alone with --no-sfm" + (f" ({reasons})" if reasons else "")
    )


def _store(captured: Captured, files: ViewFiles, content: Extracted, index: int) -> None:
    """Store a view's images in the folder. COLMAP reads focal lengths from the EXIF data of JPEG files."""
    is_jpeg = files.rgb is not None and files.rgb.suffix.lower() in (".jpg", ".jpeg")
    name = f"{index:06d}{'.jpg' if is_jpeg else '.png'}"  # without spaces, which lists of pairs cannot have
    if is_jpeg and files.rgb is not None:
        shutil.copyfile(files.rgb, captured.folder / name)
    else:
        Image.fromarray(np.round(content.rgb * 255).astype(np.uint8)).save(captured.folder / name)
    np.save(captured.folder / f"{name}.npy", content.thermal.astype(np.float32))
    captured.names[files.view] = name
    if content.mapping is not None:
        captured.mappings[files.view] = content.mapping


def _about_temperatures(folder: Path, is_celsius: bool, settings: dict[str, int]) -> list[str]:
    if not is_celsius:
        known = f"whose °C {folder / FILE} gives" if is_there(folder / FILE) else "without °C: errors need a range"
        return [f"thermal images show values {known}"]
    stated = sorted((one for one in settings if one), key=lambda one: -settings[one])
    if not stated:
        return []
    more = f" in {settings[stated[0]]} files; {len(stated) - 1} other settings" if stated[1:] else ""
    return [f"temperatures are the object's, as set in the camera: {stated[0]}{more}"]


def _mixed(folder: Path, kinds: dict[tuple[Size, Size, bool, bool], list[str]]) -> str:
    said = []
    for (rgb, thermal, is_celsius, is_inside), views in sorted(kinds.items(), key=lambda item: -len(item[1])):
        what = "" if is_celsius else " without temperatures"
        what += " in one file" if is_inside else ""
        sizes = f"RGB {rgb[0]}×{rgb[1]} and thermal {thermal[0]}×{thermal[1]}"
        said.append(f"{len(views)} with {sizes}{what} ({views[0]} …)")
    return (
        f"{folder} holds views of different cameras or settings: {'; '.join(said[:4])}. One scene is of one pair of "
        "cameras in one orientation: prepare each kind from a folder of its own"
    )

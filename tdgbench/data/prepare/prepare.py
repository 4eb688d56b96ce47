"""Make a scene in the RGBT-Scenes layout of the files of a thermal and an RGB camera."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from tdgbench.bench.lock import file_lock
from tdgbench.data.check.alignment import Offset, ViewPair, edge_offset
from tdgbench.data.prepare.extract import CountScale, Extracted, count_scale, extract, read_rgb
from tdgbench.data.prepare.mapping import Mapping, Size, from_file, inside_photo, same_view
from tdgbench.data.prepare.output import SceneWriter
from tdgbench.data.prepare.progress import step
from tdgbench.data.prepare.report import FileReport, Report
from tdgbench.data.prepare.resample import Grid, make_grid, no_distortion
from tdgbench.data.prepare.sfm import FEWEST_IMAGES, SfmOptions, Structure, reconstruct
from tdgbench.data.prepare.sources import ViewFiles, find_sources
from tdgbench.files import whole_folder
from tdgbench.scenes import SceneError
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.radiometric import PhotoMapping
from tdgbench.scenes.temperature import FILE, read_radiometry

VIEWS_FOR_OFFSET = 24


@dataclass(frozen=True)
class PrepareOptions:
    """Options of a preparation.

    pairs: patterns of thermal and RGB files. counts: meaning of 16-bit counts. mapping: where the thermal image lies in
    the RGB image, or homography: a file that says so; by default as the camera's files state, else the same view.
    width: of the output in px. range: °C of the image values 0 and 1. sfm: None stops after extraction.
    """

    pairs: tuple[str, str] | None = None
    counts: CountScale = field(default_factory=CountScale)
    mapping: PhotoMapping | None = None
    homography: Path | None = None
    width: int | None = None
    range: tuple[float, float] | None = None
    sfm: SfmOptions | None = field(default_factory=SfmOptions)


@dataclass
class Captured:
    """Extracted views, whose images wait in a folder. names: image file by view."""

    folder: Path
    names: dict[str, str] = field(default_factory=dict)
    rgb_size: Size = (0, 0)
    thermal_size: Size = (0, 0)
    mapping: PhotoMapping | None = None
    is_celsius: bool = False
    is_inside: bool = False  # whether the RGB images are the photos inside radiometric files

    def rgb(self, view: str) -> np.ndarray:
        return read_rgb(self.folder / self.names[view])

    def thermal(self, view: str) -> np.ndarray:
        return np.load(self.folder / f"{self.names[view]}.npy", allow_pickle=False)


def prepare(folder: Path, out: Path, options: PrepareOptions) -> Report:
    """Write the scene `out` of the camera files in `folder`, whole or not at all; return the report, which it holds.

    Raises SceneError naming what is wrong and the remedy; then `out` does not exist.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    with file_lock(out.with_name(f".{out.name}.lock")) as acquired:
        if not acquired:
            raise SceneError(f"another process is preparing {out}; wait for it, or choose another folder")
        if is_there(out):
            raise SceneError(f"{out} is there already; choose another folder, or remove it")
        with whole_folder(out) as part:
            report = Report(str(folder), str(out))
            _prepare(folder, part, options, report)
            (part / "report.txt").write_text(report.text(), encoding="utf-8")
            (part / "report.json").write_text(report.json(), encoding="utf-8")
    return report


def _prepare(folder: Path, part: Path, options: PrepareOptions, report: Report) -> None:
    work = part / "work"
    work.mkdir()
    captured = _extract_all(folder, work, options, report)
    mapping = _choose_mapping(captured, options)
    structure = None
    if options.sfm is not None:
        structure = reconstruct(work, list(captured.names.values()), work, options.sfm)
        _note_structure(structure, captured, report)
    source: pycolmap.Camera = no_distortion(captured.rgb_size) if structure is None else structure.camera
    grid = make_grid(source, mapping, captured.thermal_size, options.width)
    report.assumptions += [
        mapping.assumption,
        "lens distortion is the RGB camera's, removed from both images alike"
        if structure is not None
        else "images are not undistorted, and there is no model: run COLMAP on rgb/, into sparse/0",
    ]
    report.size = grid.size
    _write(part, captured, grid, structure, folder, options, report)
    shutil.rmtree(work)


def _extract_all(folder: Path, work: Path, options: PrepareOptions, report: Report) -> Captured:
    """Read all files, and keep their content in `work`. Raises SceneError for sizes that differ, and too few views."""
    sources = find_sources(folder, options.pairs)
    report.files += [FileReport(str(p), "", p.stem, "left out", why) for p, why in sources.left_out.items()]
    scale = count_scale(options.counts, read_radiometry(folder / FILE))
    captured = Captured(work)
    kinds: dict[tuple, list[str]] = {}
    with step("files to read", len(sources.views)) as count:
        for index, files in enumerate(sources.views):
            rgb = "inside" if files.rgb is None else str(files.rgb)
            one = FileReport(str(files.thermal), rgb, files.view, "written")
            report.files.append(one)
            try:
                content = extract(files, scale)
            except SceneError as error:
                one.status, one.reason = "not read", str(error)
            else:
                _keep(captured, files, content, index)
                inside = files.rgb is None
                kinds.setdefault((*content.sizes, content.is_celsius, inside, content.mapping), []).append(files.view)
            count(index + 1)
    if len(kinds) > 1:
        raise SceneError(_mixed(folder, kinds))
    if not kinds or (options.sfm is not None and len(captured.names) < FEWEST_IMAGES):
        reasons = "; ".join(f.reason for f in report.files if f.reason)[:400]
        raise SceneError(
            f"{folder} holds {len(captured.names)} usable pictures; structure from motion needs {FEWEST_IMAGES}, and a "
            f"good scene 30 or more. Take more, or extract temperatures alone with --no-sfm"
            + (f" ({reasons})" if reasons else "")
        )
    (captured.rgb_size, captured.thermal_size, captured.is_celsius, captured.is_inside, captured.mapping) = next(
        iter(kinds)
    )
    report.rgb_size, report.thermal_size = captured.rgb_size, captured.thermal_size
    if captured.is_celsius and captured.is_inside:
        report.assumptions.append("temperatures are the object's, with emissivity, distance … as set in the camera")
    if not captured.is_celsius:
        known = is_there(folder / FILE)
        what = f"whose °C {folder / FILE} gives" if known else "without °C: an error in °C needs temperature.json"
        report.assumptions.append(f"thermal images show values {what}")
    return captured


def _keep(captured: Captured, files: ViewFiles, content: Extracted, index: int) -> None:
    """Keep a view's images in the folder. COLMAP reads focal lengths from the EXIF data of JPEG files."""
    is_jpeg = files.rgb is not None and files.rgb.suffix.lower() in (".jpg", ".jpeg")
    name = f"{index:06d}{'.jpg' if is_jpeg else '.png'}"  # without spaces, which lists of pairs cannot have
    if is_jpeg and files.rgb is not None:
        shutil.copyfile(files.rgb, captured.folder / name)
    else:
        Image.fromarray(np.round(content.rgb * 255).astype(np.uint8)).save(captured.folder / name)
    np.save(captured.folder / f"{name}.npy", content.thermal.astype(np.float32))
    captured.names[files.view] = name


def _mixed(folder: Path, kinds: dict[tuple, list[str]]) -> str:
    said = []
    for (rgb, thermal, is_celsius, _, _), views in sorted(kinds.items(), key=lambda item: -len(item[1])):
        what = "" if is_celsius else " without temperatures"
        sizes = f"RGB {rgb[0]}×{rgb[1]} and thermal {thermal[0]}×{thermal[1]}"
        said.append(f"{len(views)} with {sizes}{what} ({views[0]} …)")
    return (
        f"{folder} holds views of different cameras or settings: {'; '.join(said[:4])}. One scene is of one pair of "
        "cameras in one orientation: prepare each kind from a folder of its own"
    )


def _choose_mapping(captured: Captured, options: PrepareOptions) -> Mapping:
    sizes = captured.rgb_size, captured.thermal_size
    if options.homography is not None:
        return from_file(options.homography)
    if options.mapping is not None:
        return inside_photo(options.mapping, *sizes, "--mapping")
    if captured.mapping is not None:
        return inside_photo(captured.mapping, *sizes, "as the camera's files state")
    return same_view(*sizes)


def _note_structure(structure: Structure, captured: Captured, report: Report) -> None:
    report.models, report.error_px = structure.models, structure.error_px
    report.points = len(structure.points.points)
    report.camera = f"{structure.camera.model_name}, f = {structure.camera.mean_focal_length():.0f} px"
    for one in report.files:
        name = captured.names.get(one.view)
        if one.status == "written" and name not in structure.poses:
            one.status = "not registered"
            one.reason = (
                f"COLMAP finds no pose: {structure.features[str(name)]} features, {structure.matches[str(name)]} "
                "verified matches with all other images"
            )


def _write(
    part: Path, captured: Captured, grid: Grid, structure: Structure | None, folder: Path, options: PrepareOptions,
    report: Report,
) -> None:  # fmt: skip
    """Resample and write the views that have a pose."""
    writer = SceneWriter(part, captured.is_celsius)
    written = [one for one in report.files if one.status == "written"]
    sampled = set(np.linspace(0, len(written) - 1, min(VIEWS_FOR_OFFSET, len(written))).round().astype(int))
    pairs: list[ViewPair] = []
    with step("views to write", len(written)) as count:
        for index, one in enumerate(written):
            rgb = grid.rgb(captured.rgb(one.view))
            thermal, valid = grid.thermal(captured.thermal(one.view))
            one.invalid = float(1 - valid.mean())
            writer.view(one.view, rgb, thermal, valid)
            if index in sampled:
                pairs.append(ViewPair(rgb, np.atleast_3d(thermal).astype(np.float32), valid))
            count(index + 1)
    given = options.range
    if given is None and not captured.is_celsius:
        radiometry = read_radiometry(folder / FILE)
        given = None if radiometry is None else (radiometry.range.min, radiometry.range.max)
    report.temperature, report.clipped = writer.temperature(given)
    if structure is not None:
        poses = {one.view: structure.poses[captured.names[one.view]] for one in written}
        writer.model({f"{view}.png": grid.camera(pose) for view, pose in poses.items()}, structure.points)
    offset = edge_offset(pairs)
    report.edge_offset = (
        {**offset._asdict(), "px": offset.px} if isinstance(offset, Offset) else offset.reason
    )  # fmt: skip

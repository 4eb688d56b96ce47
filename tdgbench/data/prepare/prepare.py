"""Make a scene in the RGBT-Scenes layout of the files of a thermal and an RGB camera, or of a thermal one alone."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

from tdgbench.data.check.alignment import Offset, ViewPair, chosen_views, edge_offset
from tdgbench.data.new_folder import new_folder
from tdgbench.data.prepare.capture import Capture, read_capture, too_few
from tdgbench.data.prepare.report import Report
from tdgbench.data.prepare.resample import Grid, Mapping, from_file, inside_photo, make_grid, no_distortion, same_view
from tdgbench.data.prepare.sfm import FEWEST_IMAGES, SfmOptions, Structure, reconstruct
from tdgbench.data.progress import step
from tdgbench.scenes import Camera, PointCloud, SceneError
from tdgbench.scenes.colmap import write_model
from tdgbench.scenes.radiometric import PhotoMapping
from tdgbench.scenes.temperature import FILE, CountScale, read_radiometry, robust_range
from tdgbench.thermal.contrast import picture

SAMPLES = 4096  # temperatures that are kept of each view for the percentiles
NARROWEST = 0.01  # °C, of a range


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


def prepare_scene(folder: Path, out: Path, options: PrepareOptions) -> Report:
    """Write the scene `out` of the camera files in `folder`, whole or not at all; return the report, which it holds.

    Raises SceneError naming what is wrong and the remedy; then `out` does not exist.
    """
    with new_folder(out) as part:
        report = Report(str(folder), str(out))
        _prepare(folder, part, options, report)
        (part / "report.txt").write_text(report.text(), encoding="utf-8")
        (part / "report.json").write_text(report.json(), encoding="utf-8")
    return report


def _prepare(folder: Path, part: Path, options: PrepareOptions, report: Report) -> None:
    work = part / "work"
    work.mkdir()
    thermal_alone = options.sfm is not None and options.sfm.images == "thermal"
    capture = read_capture(folder, work, options.pairs, options.counts, thermal_alone, report)
    if options.sfm is not None and len(capture.names) < FEWEST_IMAGES:
        raise too_few(folder, len(capture.names), report)
    mapping, own = _choose_mapping(capture, options)
    structure = None
    if thermal_alone:
        with step("pictures to write", len(capture.names)) as count:  # under the names that COLMAP reads
            for index, (view, name) in enumerate(capture.names.items()):
                Image.fromarray(picture(capture.thermal(view))).save(capture.folder / name)
                count(index + 1)
    if options.sfm is not None:
        structure = reconstruct(work, list(capture.names.values()), work, options.sfm)
        _note_structure(structure, capture, report)
    source: pycolmap.Camera = no_distortion(capture.kind.rgb) if structure is None else structure.camera
    grid = make_grid(source, mapping, capture.kind.thermal, options.width)
    if thermal_alone:
        report.assumptions.append("poses, points and lens distortion are found in the thermal images alone")
    elif structure is not None:
        report.assumptions += [
            mapping.assumption, "lens distortion is the RGB camera's, removed from both images alike"
        ]  # fmt: skip
    else:
        report.assumptions += [
            mapping.assumption, "images are not undistorted, and there is no model: run COLMAP on rgb/, into sparse/0"
        ]  # fmt: skip
    report.size = grid.size
    views = _write_views(part, capture, (grid, mapping, own), report)
    views.temperature(options.range or _known_range(folder, capture), report)
    if structure is not None:
        poses = {view: structure.poses[capture.names[view]] for view in views.names}
        views.model({f"{view}.png": grid.camera(pose) for view, pose in poses.items()}, structure.points)
    shutil.rmtree(work)


def _choose_mapping(capture: Capture, options: PrepareOptions) -> tuple[Mapping, dict[str, Mapping]]:
    """Return the mapping that the output is cropped by, and those of views for which the camera states others."""
    sizes = capture.kind.rgb, capture.kind.thermal
    if options.homography is not None:
        return from_file(options.homography), {}
    if options.mapping is not None:
        return inside_photo(options.mapping, *sizes, "--mapping"), {}
    stated = capture.mappings
    if not stated:
        return same_view(*sizes), {}
    fields = [(one.real_to_ir, one.offset_x, one.offset_y) for one in stated.values()]
    median = PhotoMapping(*(float(value) for value in np.median(fields, axis=0)))
    others = {view: one for view, one in stated.items() if one != median}
    by = "as the camera's files state" + (f"; {len(others)} views differ, and each has its own" if others else "")
    return inside_photo(median, *sizes, by), {
        view: inside_photo(one, *sizes, f"view {view}") for view, one in others.items()
    }


def _note_structure(structure: Structure, capture: Capture, report: Report) -> None:
    report.models, report.error_px = structure.models, structure.error_px
    report.points = len(structure.points.points)
    report.camera = f"{structure.camera.model_name}, f = {structure.camera.mean_focal_length():.0f} px"
    for file in report.files:
        name = capture.names.get(file.view)
        if file.status == "written" and name not in structure.poses:
            file.status = "not registered"
            file.reason = (
                f"COLMAP finds no pose: {structure.features[str(name)]} features, {structure.matches[str(name)]} "
                "verified matches with all other images"
            )


def _write_views(
    part: Path, capture: Capture, place: tuple[Grid, Mapping, dict[str, Mapping]], report: Report
) -> SceneWriter:  # fmt: skip
    """Resample and write the views that are in the scene, and measure the offset of their edges.

    place: the grid, the mapping of thermal images, and the views that have another one.
    """
    grid, mapping, own = place
    writer = SceneWriter(part, capture.kind.is_celsius)
    written = [one for one in report.files if one.status == "written"]
    sampled = chosen_views(len(written))
    pairs: list[ViewPair] = []
    with step("views to write", len(written)) as count:
        for index, one in enumerate(written):
            photo = capture.rgb(one.view)
            rgb = None if photo is None else grid.rgb(photo)
            thermal, valid = grid.thermal(capture.thermal(one.view), own.get(one.view, mapping))
            if not valid.any():
                raise SceneError(f"{one.file}: no measured pixel lies inside the scene's images; leave the view out")
            one.invalid = float(1 - valid.mean())
            writer.view(one.view, rgb, thermal, valid)
            if index in sampled and rgb is not None:
                pairs.append(ViewPair(rgb, np.atleast_3d(thermal).astype(np.float32), valid))
            count(index + 1)
    offset = "no RGB images" if capture.kind.is_thermal_alone else edge_offset(pairs)
    report.edge_offset = {**offset._asdict(), "px": offset.px} if isinstance(offset, Offset) else offset
    return writer


def _known_range(folder: Path, capture: Capture) -> tuple[float, float] | None:
    """Return °C of the values of shown images, if the folder's temperature.json says."""
    radiometry = None if capture.kind.is_celsius else read_radiometry(folder / FILE)
    return None if radiometry is None else (radiometry.range.min, radiometry.range.max)


class SceneWriter:
    """A writer of views, one by one, then of what concerns them all.

    is_celsius: thermal images hold °C and are written as float TIFF; else values in [0, 1], as 16-bit gray or 8-bit
    colour PNG.
    """

    def __init__(self, folder: Path, is_celsius: bool) -> None:
        self.folder, self.is_celsius = folder, is_celsius
        self.names: list[str] = []  # of the views
        self._samples: list[np.ndarray] = []  # of the views' temperatures
        (folder / "thermal").mkdir()

    def view(self, name: str, rgb: np.ndarray | None, thermal: np.ndarray, valid: np.ndarray) -> None:
        """Write a view. rgb: (H, W, 3) in [0, 1], or None. thermal: (H, W) °C or (H, W, C) in [0, 1]. valid: bool.

        A mask is written where a pixel is invalid: 255 for measured pixels, else 0.
        """
        self.names.append(name)
        if rgb is not None:
            (self.folder / "rgb").mkdir(exist_ok=True)
            picture = Image.fromarray(np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8))
            picture.save(self.folder / "rgb" / f"{name}.png")
        self._thermal(name, thermal, valid)
        if not valid.all():
            (self.folder / "masks").mkdir(exist_ok=True)
            Image.fromarray(valid.astype(np.uint8) * 255).save(self.folder / "masks" / f"{name}.png")

    def _thermal(self, name: str, thermal: np.ndarray, valid: np.ndarray) -> None:
        if self.is_celsius:
            tiff = self.folder / "thermal" / f"{name}.tiff"
            Image.fromarray(thermal.astype(np.float32)).save(tiff, compression="tiff_deflate")
            measured = thermal[valid]
            self._samples.append(measured[:: max(1, len(measured) // SAMPLES)])
        else:
            is_gray = thermal.shape[2] == 1
            levels = np.round(np.clip(thermal, 0, 1) * (65535 if is_gray else 255))
            image = levels[..., 0].astype(np.uint16) if is_gray else levels.astype(np.uint8)
            Image.fromarray(image).save(self.folder / "thermal" / f"{name}.png")

    def temperature(self, given: tuple[float, float] | None, report: Report) -> None:
        """Write temperature.json: the given range, else one from the views, if one is known; report it."""
        if given is None and not self.is_celsius:
            return
        share = None
        if self.is_celsius:
            samples = np.concatenate(self._samples)
            if given is None:
                given = _range_of(samples)
            share = float(np.mean((samples < given[0]) | (samples > given[1])))
        assert given is not None
        content = {"unit": "degC", "min": given[0], "max": given[1]}
        (self.folder / FILE).write_text(json.dumps(content) + "\n", encoding="utf-8")
        report.temperature, report.clipped = given, share

    def model(self, cameras: dict[str, Camera], points: PointCloud) -> None:
        """Write the COLMAP model of the views, by image file."""
        write_model(self.folder / "sparse" / "0", list(cameras.items()), points)


def _range_of(samples: np.ndarray) -> tuple[float, float]:
    """Return the range of image values 0 and 1, in °C: robust, and never empty."""
    try:
        span = robust_range([samples])
        return span.min, span.max
    except ValueError:  # nearly all are equal
        low = float(np.median(samples))
        return low, low + NARROWEST

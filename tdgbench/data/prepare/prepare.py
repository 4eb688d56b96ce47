"""Make a scene in the RGBT-Scenes layout of the files of a thermal and an RGB camera, or of a thermal one alone."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from pydantic import ConfigDict, TypeAdapter

from tdgbench.data.folders import Stages, new_folder
from tdgbench.data.poses.references import read_reference
from tdgbench.data.prepare.calibration import checked_lenses, exif_focal
from tdgbench.data.prepare.capture import Capture, Kind, read_capture, too_few, write_pictures
from tdgbench.data.prepare.known_poses import known_poses, structure_of
from tdgbench.data.prepare.places import coordinates, doubted_by_height
from tdgbench.data.prepare.report import Report
from tdgbench.data.prepare.resample import Grid, Mapping, from_file, inside_photo, make_grid, no_distortion, same_view
from tdgbench.data.prepare.sfm import FEWEST_IMAGES, SfmOptions, Structure, reconstruct
from tdgbench.data.prepare.sources import find_sources
from tdgbench.data.progress import step
from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import write_model
from tdgbench.scenes.formats import PhotoMapping
from tdgbench.scenes.formats.pictures import JPEG
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.temperature import FILE, CountScale, read_radiometry, temperature_file

READ = TypeAdapter(tuple[Capture, Report], config=ConfigDict(ser_json_inf_nan="constants"))  # what was read, as JSON


@dataclass(frozen=True)
class PrepareOptions:
    """Options of a preparation.

    pairs: patterns of thermal and RGB files. counts: meaning of 16-bit counts. mapping: where the thermal image lies in
    the RGB image, or homography: a file that says so; by default as the camera's files state, else the same view.
    poses: a file or folder as of `read_reference`, of the images that `sfm` names. extracts_only: stops before them.
    """

    pairs: tuple[str, str] | None = None
    counts: CountScale = field(default_factory=CountScale)
    mapping: PhotoMapping | None = None
    homography: Path | None = None
    sfm: SfmOptions = field(default_factory=SfmOptions)
    poses: Path | None = None
    extracts_only: bool = False

    @property
    def thermal_alone(self) -> bool:
        """Whether there are no RGB images."""
        return self.sfm.images == "thermal"


def prepare_scene(folder: Path, out: Path, options: PrepareOptions) -> Report:
    """Write the scene `out` of the camera files in `folder`, whole or not at all; return the report, which it holds.

    Raises SceneError naming what is wrong and the remedy; then `out` does not exist.
    """
    stages = Stages(out.with_name(f".{out.name}.work"))
    try:
        with new_folder(out) as part:
            report = _prepare(folder, part, stages, options, Report(str(folder), str(out)))
            (part / "report.txt").write_text(report.text(), encoding="utf-8")
            (part / "report.json").write_text(report.json(), encoding="utf-8")
    except KeyboardInterrupt as error:
        if stages.folder.exists():
            error.add_note("the same command goes on after the last finished stage")
        raise
    shutil.rmtree(stages.folder, ignore_errors=True)
    return report


def _prepare(folder: Path, part: Path, stages: Stages, options: PrepareOptions, report: Report) -> Report:
    capture, report = _read(folder, stages, options, report)
    mapping, own = _choose_mapping(capture, options)
    structure = None
    if not options.extracts_only:
        structure = _structure(folder, capture, stages, options.sfm, options.poses, report)
    source: pycolmap.Camera = no_distortion(capture.kind.rgb) if structure is None else structure.camera
    grid = make_grid(source, mapping, capture.kind.thermal)
    report.assumptions += _about_images(mapping, options)
    report.size, report.rgb_px = grid.size, grid.crop.pinhole.focal_length_x / float(grid.K[0, 0])
    if mapping.stated is not None and not options.thermal_alone:
        report.mapping = mapping.stated.real_to_ir, mapping.stated.offset_x, mapping.stated.offset_y
    radiometry = None if capture.kind.is_celsius else read_radiometry(temperature_file(folder))
    if radiometry is not None:
        low, high = report.temperature = radiometry.range.min, radiometry.range.max
        content = json.dumps({"unit": "degC", "min": low, "max": high})
        (part / FILE).write_text(f"{content}\n", encoding="utf-8")
    _write_views(part, capture, grid, mapping, own, report)
    if structure is not None:
        names = {one.view: capture.views[one.view].image for one in report.written}
        cameras = [(f"{view}.png", grid.camera(structure.poses[image])) for view, image in names.items()]
        write_model(part / "sparse" / "0", cameras, structure.points)
    return report


def _about_images(mapping: Mapping, options: PrepareOptions) -> list[str]:
    """Return what is assumed of where thermal images lie in RGB images, and of the lens."""
    if options.extracts_only:
        where = "pictures of thermal/" if options.thermal_alone else "rgb/"
        lens = [f"images are not undistorted, without a model: run COLMAP on {where}, into sparse/0"]
    elif not options.thermal_alone:
        lens = ["lens distortion is the RGB camera's, removed from both images alike"]
    else:
        found = "poses, points and lens distortion are found in the thermal images alone"
        lens = [found] if options.poses is None else []
    return lens if options.thermal_alone else [mapping.assumption, *lens]


def _read(folder: Path, stages: Stages, options: PrepareOptions, report: Report) -> tuple[Capture, Report]:
    """Read the camera's files, or what an earlier run stored of them: the capture, and the report until then."""
    thermal_alone = options.thermal_alone
    sources = find_sources(folder, options.pairs, thermal_alone)
    files = (path for view in sources.views for path in (view.thermal, view.rgb, view.origin) if path is not None)
    used = [temperature_file(folder), *files]
    states = [(str(path), path.stat().st_size, path.stat().st_mtime_ns) for path in used if is_there(path)]

    def write(place: Path) -> None:
        capture = read_capture(folder, place, sources, options.counts, thermal_alone, report)
        if thermal_alone:
            write_pictures(capture)
        (place / "capture.json").write_bytes(READ.dump_json((capture, report)))

    inputs = states, sources, options.counts, thermal_alone, report
    place = stages.make("images", inputs, write)
    capture, report = READ.validate_json((place / "capture.json").read_bytes())
    return replace(capture, folder=place), report


def _structure(
    folder: Path, capture: Capture, stages: Stages, sfm: SfmOptions, poses: Path | None, report: Report
) -> Structure:
    """Return poses, lens and points: those of a file of poses, else those that COLMAP finds; report them."""
    positions = _positions(capture, report) if poses is None and sfm.matching == "nearest" else None
    if len(capture.views) < FEWEST_IMAGES:
        raise too_few(folder, len(capture.views), report)
    if poses is None:
        sfm = _with_lens(sfm, report, capture.kind)
        names = [view.image for view in capture.views.values()]
        structure = reconstruct(capture.folder, names, stages, sfm, positions)
        heights = {view.image: view.taken.height for view in capture.views.values() if view.taken.height is not None}
        known_heights = [(structure.poses[image], heights[image]) for image in structure.poses if image in heights]
        if structure.is_in_metres and known_heights:
            focal, points = structure.camera.mean_focal_length(), structure.points.points
            structure.notes.extend(doubted_by_height(known_heights, points, focal))
    else:
        reference = read_reference(poses)
        known = known_poses(poses, reference, capture, report)
        if sfm.focal is None and not sfm.calibration:
            stated = known.lenses(*([{*known.lens_ids.values()}] if known.lens_ids else []))
            sfm = replace(sfm, calibration=checked_lenses(stated, poses) if stated else ())
        sfm = _with_lens(sfm, report, capture.kind)
        if sfm.focal is None and not sfm.calibration:
            raise SceneError(f"{poses} states no lens: say it by --calibration FILE or --focal PX")
        structure = structure_of(known, capture.folder, capture.kind.rgb, stages, sfm)
    _note_structure(structure, capture, report)
    return structure


def _positions(capture: Capture, report: Report) -> np.ndarray:
    """Return positions (N, 3) in m of the views that have one; others leave the capture."""
    found = coordinates({name: one.taken.gps for name, one in capture.views.items() if one.taken.gps is not None})
    for file in report.written:
        if file.view not in found:
            file.drop("left out", "no GPS position with altitude, as --matching nearest needs")
    capture.keep(found)
    return np.array(list(found.values()))


def _with_lens(options: SfmOptions, report: Report, kind: Kind) -> SfmOptions:
    """Return options with the focal length that all files state in EXIF data, unless one is known; and report it.

    COLMAP itself reads that of JPEG files, but not of the pictures that are written for it.
    """
    if options.focal is not None or options.calibration:
        what = f"focal length {options.focal:g} px" if options.focal is not None else "known lens"
        report.assumptions.append(f"{what}, {'which COLMAP refines' if options.refine else 'which is kept'}")
        return options
    paths = [Path(one.rgb or one.origin or one.file) for one in report.written if one.rgb != "inside"]
    stated = {exif_focal(path, kind.rgb) for path in paths if kind.is_thermal_alone or path.suffix.lower() not in JPEG}
    focal = stated.pop() if len(stated) == 1 else None
    if focal is None:
        return options
    report.assumptions.append(f"COLMAP begins with the focal length that the files' EXIF data state, {focal:.0f} px")
    return replace(options, focal=focal, refine=True, is_of_exif=True)


def _choose_mapping(capture: Capture, options: PrepareOptions) -> tuple[Mapping, dict[str, Mapping]]:
    """Return the mapping that the output is cropped by, and those of views for which the camera states others."""
    sizes = capture.kind.rgb, capture.kind.thermal
    if options.homography is not None:
        return from_file(options.homography), {}
    if options.mapping is not None:
        return inside_photo(options.mapping, *sizes, "--mapping"), {}
    stated = {name: view.mapping for name, view in capture.views.items() if view.mapping is not None}
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
    report.assumptions += structure.notes
    report.camera = f"{structure.camera.model_name}, f = {structure.camera.mean_focal_length():.0f} px"
    for file in report.written:
        image = capture.views[file.view].image
        if image not in structure.poses:
            file.drop(
                "not registered",
                f"COLMAP finds no pose: {structure.features[image]} features, {structure.matches[image]} verified "
                "matches with all other images",
            )


def _write_views(
    part: Path, capture: Capture, grid: Grid, mapping: Mapping, own: dict[str, Mapping], report: Report
) -> None:
    """Resample and write the views of the scene. mapping: of thermal images but those of `own`, by view.

    Levels of 8 bits stay so without a range, as 16 bits would be read as counts.
    """
    written, are_levels = report.written, not capture.kind.counts and report.temperature is None
    with step("views to write", len(written)) as count:
        for index, one in enumerate(written):
            photo = capture.rgb(one.view)
            rgb = None if photo is None else grid.rgb(photo)
            thermal, valid = grid.thermal(capture.thermal(one.view), own.get(one.view, mapping))
            if not valid.any():
                raise SceneError(f"{one.file}: no measured pixel lies inside the scene's images; leave the view out")
            one.invalid = float(1 - valid.mean())
            _write_view(part, one.view, rgb, thermal, valid, np.uint8 if are_levels else np.uint16)
            count(index + 1)


def _write_view(
    folder: Path, name: str, rgb: np.ndarray | None, thermal: np.ndarray, valid: np.ndarray, gray: type[np.integer]
) -> None:
    """Write the images of a view, and a mask where a pixel is invalid: 255 for measured pixels, else 0.

    °C (H, W) become float TIFF; values (H, W, C) in [0, 1], as RGB images are, PNG: `gray`, or 8-bit colour.
    """
    files = {}
    if rgb is not None:
        files[f"rgb/{name}.png"] = np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)
    if thermal.ndim == 2:
        files[f"thermal/{name}.tiff"] = thermal.astype(np.float32)
    elif thermal.shape[2] == 1:
        files[f"thermal/{name}.png"] = np.round(np.clip(thermal[..., 0], 0, 1) * np.iinfo(gray).max).astype(gray)
    else:
        files[f"thermal/{name}.png"] = np.round(np.clip(thermal, 0, 1) * 255).astype(np.uint8)
    if not valid.all():
        files[f"masks/{name}.png"] = valid.astype(np.uint8) * 255
    for place, pixels in files.items():
        (folder / place).parent.mkdir(exist_ok=True)
        Image.fromarray(pixels).save(folder / place, compression="tiff_deflate")  # which PNG ignores

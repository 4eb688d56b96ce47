"""`python -m benchmarks.captures CHECKOUTS OUT [--only NAME ...]`: scenes of public thermal captures.

CHECKOUTS holds git checkouts, in folders named as the repository or OWNER+REPOSITORY. `dataset=folder
data.root=OUT/<scene>` reads what is made. Nothing of these captures is shipped with tdgbench.

river    a river and its banks from a drone (FLIR Vue Pro, 16-bit counts, 1 s apart). river_unbiased: without the
         camera's fixed pattern, which river_pattern.npy holds, in counts. chuckaustin/devilsRiver 156557a, MIT
orchard  an orchard by a river, from a drone that flies there and back (DJI Mavic 2 Enterprise Advanced): the palette's
         luminance, 8-bit gray with the camera's gain control and sharpening. orchard_counts: the files' 16-bit counts.
         Steve-Rye/DJI_thermal_orthomosaic 731fa58, MIT
plots    field plots from 40 m, three flight lines (DJI Zenmuse XT, °C), with the poses of their Metashape project.
         TreAgron/ThermalMultiviewExample 2092a45, which has no licence: do not pass on what is made of it
fresco   a frescoed room, hand-held (Workswell WIRIS Pro, °C), with RGB, which the poses are from. The camera drifts by
         7 °C. nneilsutherland/Thermitage 6c85363, MIT
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from PIL import Image

from tdgbench.data.poses.references import read_reference
from tdgbench.data.prepare.contrast import picture
from tdgbench.data.prepare.known_poses import KnownPoses, structure_of
from tdgbench.data.prepare.prepare import PrepareOptions, prepare_scene
from tdgbench.data.prepare.sfm import SfmOptions, Structure, reconstruct
from tdgbench.data.prepare.stages import Stages
from tdgbench.files import whole_folder
from tdgbench.scenes import SceneError
from tdgbench.scenes.radiometric import dji_counts
from tdgbench.scenes.temperature import CountScale

SFM = SfmOptions("thermal", seed=0, threads=1)
RGB_SIZE = 960, 540  # of fresco, half that of the files: thermal images have 640×512 px
RGB_TO_THERMAL = "0.8916 0.0023 -122.53 -0.0028 0.8822 18.07 -5.5e-6 -6.5e-6 1"  # homography, px; to 1 px RMS


class Capture(NamedTuple):
    """Where a capture comes from, and what makes its scenes in the folder OUT of so many of its views."""

    repository: str
    commit: str
    views: int
    make: Callable[[Path, Path, int], None]


def main() -> None:
    formatter = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("python -m benchmarks.captures", None, __doc__, formatter_class=formatter)
    parser.add_argument("checkouts", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="+", choices=CAPTURES, default=list(CAPTURES), metavar="NAME")
    parser.add_argument("--views", type=int, help="successive views of a capture; by default enough for a short test")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.only:
        capture = CAPTURES[name]
        try:
            capture.make(checkout(args.checkouts, capture), args.out, args.views or capture.views)
        except SceneError as error:
            sys.exit(f"{name}: {error}")


def checkout(folder: Path, capture: Capture) -> Path:
    """The checkout of a capture's repository; ends the program if it is not there, and says what to clone."""
    names = capture.repository.replace("/", "+"), capture.repository.split("/")[1]
    found = next((folder / name for name in names if (folder / name).is_dir()), None)
    if found is None:
        sys.exit(
            f"{folder} has no {names[0]}: git clone https://github.com/{capture.repository} {folder / names[0]}, "
            f"then git checkout {capture.commit} there"
        )
    return found


def river(source: Path, out: Path, views: int) -> None:
    first = 30  # COLMAP registers all of the 60 views from there
    raw = read_frames(sorted((source / "RawData").glob("*.tiff"))[first:][:views])
    unbiased = read_frames([source / "TIFFs - pixel bias removed" / f"{name}.tiff" for name in raw])
    model = structure(unbiased)
    write_scene(out / "river", raw, model)
    write_scene(out / "river_unbiased", unbiased, model)
    differences = [raw[name].astype(np.float32) - unbiased[name] for name in raw]
    np.save(out / "river_pattern.npy", np.mean(differences, axis=0))


def orchard(source: Path, out: Path, views: int) -> None:
    files = sorted((source / "examples").glob("*.JPG"))[:views]
    counts = {path.stem: found for path in files if (found := dji_counts(path)) is not None}
    model = structure(counts)
    write_scene(out / "orchard", {path.stem: np.asarray(Image.open(path).convert("L")) for path in files}, model)
    write_scene(out / "orchard_counts", counts, model)


def plots(source: Path, out: Path, views: int) -> None:
    archive = source / "Output" / "CH_1260_P004_20210701.13.50.1_40m_Therm.files" / "0" / "chunk.zip"
    first, last = "DJI_0016", "DJI_0131"  # from the start of a flight line to the end; those from 0897 on are before
    images = sorted((source / "ThermalData" / "1" / "Grayscale").glob("*.tiff"))
    files = [path for path in images if first <= path.stem <= last]
    frames = {name: (frame / 1000).astype(np.float32) for name, frame in read_frames(files[:views]).items()}
    write_scene(out / "plots", frames, structure(frames, archive))


def fresco(source: Path, out: Path, views: int) -> None:
    captured = source / "data" / "ARCO_ArcoCastle_TN_ITA" / "ARCO_30_10_2024_I (WWP)"
    with tempfile.TemporaryDirectory() as folder:
        files = Path(folder) / "files"
        files.mkdir()
        for path in sorted((captured / "RadTIFF").glob("*.tiff"))[:views]:
            view = path.stem.removesuffix("-radiometric")
            shutil.copy(path, files / f"{view}.tiff")
            with Image.open(captured / "VisJPG" / f"{view}-visible.jpg") as photo:
                photo.resize(RGB_SIZE, Image.Resampling.BOX).save(files / f"{view}.png")
        mapping = Path(folder) / "homography.txt"
        mapping.write_text(RGB_TO_THERMAL, encoding="utf-8")
        options = PrepareOptions(counts=CountScale(0.025, -100.0), homography=mapping, sfm=replace(SFM, images="rgb"))
        report = prepare_scene(files, out / "fresco", options)
    print(report.text())


def read_frames(files: list[Path]) -> dict[str, np.ndarray]:
    """Images of one channel (H, W), by view."""
    return {path.stem: np.asarray(Image.open(path)) for path in files}


def structure(frames: Mapping[str, np.ndarray], poses: Path | None = None) -> Structure:
    """COLMAP's model of thermal frames (H, W) by view; poses: a file of them and of the lens, for points alone."""
    with tempfile.TemporaryDirectory() as folder:
        images, stages = Path(folder), Stages(Path(folder) / "work")
        for view, frame in frames.items():
            Image.fromarray(picture(frame)).save(images / f"{view}.png")
        if poses is None:
            return reconstruct(images, [f"{view}.png" for view in frames], stages, SFM)
        known = read_reference(poses)
        posed = KnownPoses({f"{view}.png": known.poses[view] for view in frames}, None)
        size = next(iter(frames.values())).shape[1::-1]
        return structure_of(posed, images, size, stages, replace(SFM, calibration=tuple(known.lenses())))


def write_scene(folder: Path, frames: Mapping[str, np.ndarray], found: Structure) -> None:
    """Write the registered views (8 bits, raw counts, or float in °C) and the model; print what they are."""
    model, camera = pycolmap.Reconstruction(), found.camera
    model.add_camera_with_trivial_rig(camera)
    for number, (name, pose) in enumerate(found.poses.items(), 1):
        image = pycolmap.Image(name, camera_id=camera.camera_id, image_id=number)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    for xyz, color in zip(found.points.points, np.round(found.points.colors * 255).astype(np.uint8), strict=True):
        model.add_point3D(xyz, pycolmap.Track(), color)
    with whole_folder(folder) as part:
        (part / "thermal").mkdir()
        (part / "sparse" / "0").mkdir(parents=True)
        for view, frame in frames.items():
            if f"{view}.png" in found.poses:
                suffix = "png" if frame.dtype == np.uint8 else "tiff"
                Image.fromarray(frame).save(part / "thermal" / f"{view}.{suffix}")
        model.write(part / "sparse" / "0")
    views, points = f"{len(found.poses)} of {len(frames)} views", f"{len(found.points.points)} points"
    print(f"{folder}: {views}, {points}, {found.error_px:.2f} px, f = {camera.mean_focal_length():.0f} px", flush=True)


CAPTURES = {
    "river": Capture("chuckaustin/devilsRiver", "156557a", 60, river),
    "orchard": Capture("Steve-Rye/DJI_thermal_orthomosaic", "731fa58", 33, orchard),
    "fresco": Capture("nneilsutherland/Thermitage", "6c85363", 40, fresco),
    "plots": Capture("TreAgron/ThermalMultiviewExample", "2092a45", 64, plots),
}

if __name__ == "__main__":
    main()

"""`tdgbench data export`: scenes as others read them: 3DGS and ThermalGaussian, nerfstudio and ThermoNeRF, Özer et al.

Readers: chen-hangyu/Thermal-Gaussian-main 050c291, scene/dataset_readers.py; nerfstudio-project/nerfstudio 50e0e3c,
nerfstudio/data/dataparsers/nerfstudio_dataparser.py; Schindler-EPFL-Lab/thermo-nerf 08d9be9, thermo_nerf/thermal_nerf/
thermal_dataparser.py; mert-o/ThermalNeRFs d822bd1, nerf/colmap_provider.py.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from PIL import Image
from plyfile import PlyData, PlyElement

from tdgbench.bench.options import check_options
from tdgbench.data.folders import new_folder
from tdgbench.resources import conf_folder
from tdgbench.scenes import PointCloud, Scene, SceneError, View
from tdgbench.scenes.colmap import write_model
from tdgbench.scenes.layouts.transforms import OPENGL_TO_OPENCV
from tdgbench.scenes.temperature import BOUNDS_FILE, BOUNDS_KEYS, FILE, KEYS
from tdgbench.terminal import say
from tdgbench.text import one_line

STATEMENT = "export.json"
OBSERVATIONS = 1000  # 2D points of an image


@dataclass
class Statement:
    """Content of export.json: the split, and the meaning of values, so that renders can be turned back.

    train, test: names of the views, in the order in which the format's readers number them. unit: of black and white,
    the values of image values 0 and 1: °C, counts, or `image value` where neither is known. rounding: largest error of
    an 8-bit thermal image against the scene's, in this unit. fingerprint: of the scene's files.
    """

    format: str
    scene: str
    fingerprint: str
    split: str
    train: list[str]
    test: list[str]
    notes: list[str]
    unit: str = "image value"
    black: float = 0.0
    white: float = 1.0
    rounding: float = 0.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="the scene's folder, in any layout")
    parser.add_argument("out", type=Path, metavar="OUT", help="folder to write, which must not exist")
    parser.add_argument("--format", choices=FORMATS, required=True, help="of the readers: docs/other-programs.md")
    parser.add_argument("--data", nargs="+", default=[], metavar="OPTION=VALUE",
                        help="options data.* of a training, such as split=every_8th width=640")  # fmt: skip


def run(arguments: argparse.Namespace) -> int:
    """Export a scene, read as by a training with these options, and print what its readers have to know."""
    if any(option.startswith("root=") for option in arguments.data):
        raise SceneError(f"--data {' '.join(arguments.data)}: the root is SCENE; leave it out")
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        cfg = compose("config", overrides=["dataset=folder", *(f"data.{option}" for option in arguments.data)])
    cfg.data.root = str(arguments.scene)
    check_options(cfg)
    scene: Scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    for note in export_scene(scene, arguments.out, arguments.format).notes:
        say(one_line(note), "note", "dim")
    say(f"{arguments.out}: {len(scene.train)} training and {len(scene.test)} test views; values are in {STATEMENT}")
    return 0


def export_scene(scene: Scene, out: Path, name: str) -> Statement:
    """Write a scene into the folder `out` in a format (a key of FORMATS), whole or not at all.

    Cameras are pinholes and images are those of a training: undistorted, resized, in the scene's range. Returns what
    `export.json` says beside them. Raises SceneError, for one if `out` exists.
    """
    write, order = FORMATS[name]
    train, test = (sorted((view.name for view in views), key=order) for views in (scene.train, scene.test))
    notes = [*scene.notes, *(f"assumed {key}: {line}" for key, line in scene.assumed.items()), *scene.doubts]
    statement = Statement(name, scene.name, scene.fingerprint, scene.split, train, test, notes)
    if scene.channels == 1 and scene.temperature is not None:
        statement.unit, statement.black, statement.white = "°C", scene.temperature.min, scene.temperature.max
    elif scene.channels == 1 and scene.raw_count_range is not None:
        statement.unit, (statement.black, statement.white) = "counts", scene.raw_count_range
    with new_folder(out) as part:
        write(scene, part, statement)
        _write_json(part / STATEMENT, asdict(statement))
    return statement


def _write_3dgs(scene: Scene, folder: Path, statement: Statement) -> None:
    """COLMAP model, `images/` of thermal images, and ThermalGaussian's `thermal/` and `rgb/`; three channels."""
    pictures = _Pictures(scene, folder, statement)
    for part, views in (("train", scene.train), ("test", scene.test)):
        for view in views:
            pictures.thermal(view, f"thermal/{part}", "images", color=True)
            pictures.rgb(view, f"rgb/{part}")
    pictures.masks("these readers know no masks: they train on and score black there")
    _write_model(scene, folder / "sparse" / "0")
    _write_range(folder / FILE, statement)
    cameras = [view.camera for view in scene.views]
    off = max(float(np.abs(camera.K[:2, 2] - (camera.width / 2, camera.height / 2)).max()) for camera in cameras)
    if off > 1e-6:
        statement.notes.append(
            f"readers of 3DGS ignore the principal point, which is up to {off:.3g} px off the image's centre: their "
            "cameras differ; data.principal_point=center has both use the centre"
        )
    if sorted(f"{view.name}.png" for view in scene.views)[::8] != sorted(f"{view.name}.png" for view in scene.test):
        statement.notes.append(
            "systems that read images/ test every 8th view, which is not this split; data.split=every_8th is theirs"
        )


def _write_nerfstudio(scene: Scene, folder: Path, statement: Statement) -> None:
    """transforms.json with lists of the split and `thermal_file_path`; the same with thermal images alone; points."""
    pictures = _Pictures(scene, folder, statement)
    for view in scene.views:
        pictures.thermal(view, "thermal")
        pictures.rgb(view, "images")
    masked = pictures.masks("nerfstudio leaves them out; ThermoNeRF reads no masks and trains on black there")
    if scene.points is not None:
        _write_ply(folder / "sparse_pc.ply", scene.points)
    _write_range(folder / BOUNDS_FILE, statement, BOUNDS_KEYS)
    files = {"transforms.json": "images" if pictures.has_rgb else "thermal"}
    files |= {"transforms_thermal_only.json": "thermal"} if pictures.has_rgb else {}
    for file, images in files.items():
        lists = {"train": statement.train, "val": statement.test, "test": statement.test}
        content = {
            "camera_model": "PINHOLE",
            "frames": [_frame(view, images, masked) for view in scene.views],
            **{f"{split}_filenames": [f"{images}/{name}.png" for name in names] for split, names in lists.items()},
            **({} if scene.points is None else {"ply_file_path": "sparse_pc.ply"}),
        }
        _write_json(folder / file, content)


def _frame(view: View, images: str, masked: bool) -> dict[str, object]:
    camera, to_world = view.camera, np.linalg.inv(view.camera.world_to_camera)
    to_world[:3, :3] = to_world[:3, :3] @ OPENGL_TO_OPENCV
    return {
        "file_path": f"{images}/{view.name}.png", "thermal_file_path": f"thermal/{view.name}.png",
        **({"mask_path": f"masks/{view.name}.png"} if masked else {}),
        "w": camera.width, "h": camera.height, "fl_x": camera.K[0, 0], "fl_y": camera.K[1, 1],
        "cx": camera.K[0, 2], "cy": camera.K[1, 2], "transform_matrix": to_world.tolist(),
    }  # fmt: skip


def _write_oezer(scene: Scene, folder: Path, statement: Statement) -> None:
    """`colmap_sparse/0`, `rgb/`, and `warped_thermal/` with arrays in °C and, for fine-tuning, pictures."""
    if statement.unit != "°C":
        raise SceneError(
            f"{scene.name} has no thermal images of one channel in °C, which this format holds; set "
            "data.temperature=[min,max], or data.thermal=radiometric where raw_images/ has them"
        )
    if len({(view.camera.width, view.camera.height) for view in scene.views}) > 1:
        raise SceneError(f"{scene.name} has views of several sizes, which these readers cannot stack; set data.width")
    blind = [view.name for view in scene.views if scene.points and not view.camera.shows(scene.points.points).any()]
    if blind:
        raise SceneError(f"view {blind[0]} of {scene.name} sees no sparse point, which its reader needs; remove it")
    pictures = _Pictures(scene, folder, statement)
    for view in scene.views:
        pictures.thermal(view, "warped_thermal")
        degC = statement.black + view.thermal[..., 0] * np.float64(statement.white - statement.black)
        np.save(folder / "warped_thermal" / f"{view.name}.npy", degC.astype(np.float32))
        pictures.rgb(view, "rgb")
    pictures.masks(f"this reader knows no masks: it trains on and scores {statement.black:g} °C there")
    _write_model(scene, folder / "colmap_sparse" / "0", OBSERVATIONS)
    _write_range(folder / FILE, statement)
    indices = [index for index, view in enumerate(scene.views) if view.name in statement.test]
    statement.notes += [
        f"run with --tv {statement.white:g} --tv_min {statement.black:g}; --val_idx holds one view out, these are the "
        f"test views: val_ids = {indices} in nerf/colmap_provider.py",
        "2D points of images are projections of sparse points, hidden ones too, as no tracks are known",
    ]


class _Pictures:
    """Writes 8-bit PNG files. has_rgb: whether every view has an RGB image; else none is written."""

    def __init__(self, scene: Scene, folder: Path, statement: Statement) -> None:
        self.scene, self.folder, self.statement = scene, folder, statement
        without = sum(view.load_rgb is None for view in scene.views)
        self.has_rgb = without == 0
        if without:
            statement.notes.append(f"{without} of {len(scene.views)} views have no RGB image, so none is written")

    def thermal(self, view: View, *places: str, color: bool = False) -> None:
        """Write a thermal image into folders. color: gray ones, too, have three channels."""
        error = max(self._save(view.thermal, place, view.name, color) for place in places)
        in_unit = error * (self.statement.white - self.statement.black)
        self.statement.rounding = max(self.statement.rounding, in_unit)

    def rgb(self, view: View, place: str) -> None:
        if self.has_rgb and view.load_rgb is not None:
            self._save(view.load_rgb(), place, view.name, True)  # not view.rgb, which would stay in memory

    def masks(self, note: str) -> bool:
        """Write masks of all views, 0 where nothing was measured, if some pixels were not; return whether."""
        if all(view.valid is None for view in self.scene.views):
            return False
        for view in self.scene.views:
            valid = np.ones(view.thermal.shape[:2]) if view.valid is None else view.valid
            self._save(valid[..., None], "masks", view.name, False)
        self.statement.notes.append(f"pixels without a measurement are 0 in masks/; {note}")
        return True

    def _save(self, image: np.ndarray, place: str, name: str, color: bool) -> float:
        """Save an image (H, W, C) of [0, 1]; return the largest error of rounding."""
        levels = np.round(np.asarray(image, np.float64) * 255).astype(np.uint8)
        plain = Image.fromarray(levels[..., 0] if levels.shape[2] == 1 else levels)
        path = self.folder / place / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        (plain.convert("RGB") if color else plain).save(path)
        return float(np.abs(levels.astype(np.float32) / np.float32(255) - image).max())


def _write_model(scene: Scene, folder: Path, observations: int = 0) -> None:
    if scene.points is None:
        raise SceneError(f"{scene.name} has no sparse points, from which these systems start; run COLMAP on its images")
    write_model(folder, [(f"{view.name}.png", view.camera) for view in scene.views], scene.points, observations)


def _write_range(path: Path, statement: Statement, keys: tuple[str, str] = KEYS) -> None:
    """Write °C of black and white, where they are known, as this package and ThermoNeRF read them."""
    if statement.unit == "°C":
        _write_json(path, dict(zip(keys, (statement.black, statement.white), strict=True)))


def _write_json(path: Path, content: object) -> None:
    path.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def _write_ply(path: Path, points: PointCloud) -> None:
    kinds = [*((axis, "f8") for axis in "xyz"), *((channel, "u1") for channel in ("red", "green", "blue"))]
    rows = np.rec.fromarrays([*points.points.T, *np.round(points.colors.T * 255)], kinds)
    PlyData([PlyElement.describe(rows, "vertex")]).write(path)


# By name: what writes one, and by what its readers sort the names of views.
FORMATS: dict[str, tuple[Callable[[Scene, Path, Statement], None], Callable[[str], str]]] = {
    "3dgs": (_write_3dgs, lambda name: name.split(".")[0]),
    "nerfstudio": (_write_nerfstudio, lambda name: f"{name}.png"),
    "oezer": (_write_oezer, str),
}

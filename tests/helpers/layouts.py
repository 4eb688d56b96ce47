"""Small scenes in exactly the layouts in which authors ship theirs, made from a scene with known temperatures.

Sources of the layouts: the docstrings of `tdgbench/scenes/layouts/`.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image
from plyfile import PlyData, PlyElement

from tdgbench.scenes import Scene, View
from tdgbench.scenes.colmap import write_model as write_pinholes
from tdgbench.scenes.synthetic.capture import CameraTruth, TrueCamera
from tests.helpers.flir import FlirCamera, write_flir

DISTORTIONS = {"SIMPLE_PINHOLE": [], "PINHOLE": [], "SIMPLE_RADIAL": [0.05], "OPENCV": [0.05, 0.01, 0.002, -0.001]}
LOST = "lost"  # a view of every model that no file shows
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
APPLIED = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0]])  # nerfstudio's applied_transform


def celsius(view: View, scene: Scene) -> np.ndarray:
    """Temperatures (H, W) float32 of a view, °C."""
    span = scene.temperature
    return (span.min + view.thermal.mean(axis=2) * (span.max - span.min)).astype(np.float32)


def read_truth(folder: Path) -> CameraTruth:
    """The true thermal camera that a synthetic scene's folder holds."""
    with np.load(folder / "camera" / "camera.npz") as file:
        stored = dict(file)
    return CameraTruth(stored.pop("names").tolist(), TrueCamera(**stored))


def write_thermalmix(
    scene: Scene,
    folder: Path,
    *,
    model: str = "colmap_sparse/0",
    photos: str = "rgb",
    camera: str = "SIMPLE_RADIAL",
    change: Callable[[np.ndarray, int], np.ndarray] = lambda degC, number: degC,
) -> Path:
    """`warped_thermal/<view>.npy` in °C, RGB as .jpg where the model says .JPG. change: of an array, by view number."""
    write_model(scene, folder / model, camera, ".JPG")
    for sub in (photos, "warped_thermal"):
        (folder / sub).mkdir(parents=True)
    scale = int(photos.rpartition("_")[2]) if "_" in photos else 1
    for number, view in enumerate(scene.views):
        photo = _picture(view.rgb)
        photo.resize((photo.width // scale, photo.height // scale)).save(folder / photos / f"{view.name}.jpg")
        np.save(folder / "warped_thermal" / f"{view.name}.npy", change(celsius(view, scene), number))
    return folder


def write_downloaded_thermalmix(
    scene: Scene, folder: Path, *, camera: str = "PINHOLE", frame: int = 0, states_range: bool = False
) -> Path:  # fmt: skip
    """ThermalMix before the authors' script makes arrays: `warped_thermal/<view>.jpg`, `thermal/<view>.jpg`.

    The latter are the images before the warp, of another size. frame: columns at the left that the warp leaves black.
    states_range: whether a temperature.json says °C of black and white; the authors ship none.
    """
    write_model(scene, folder / "colmap_sparse" / "0", camera, ".JPG")
    for sub in ("rgb", "thermal", "warped_thermal"):
        (folder / sub).mkdir(parents=True)
    for view in scene.views:
        _picture(view.rgb).save(folder / "rgb" / f"{view.name}.jpg", quality=95)
        warped = _picture(view.thermal).convert("L")
        before = warped.resize((64, 64), Image.Resampling.NEAREST)  # a warp interpolates; it makes nothing darker
        before.save(folder / "thermal" / f"{view.name}.jpg", quality=95)
        warped.paste(0, (0, 0, frame, warped.height))
        warped.save(folder / "warped_thermal" / f"{view.name}.jpg", quality=95)
    if states_range:
        (folder / "temperature.json").write_text(json.dumps(asdict(scene.temperature)), encoding="utf-8")
    return folder


def write_rgbt_scenes(scene: Scene, folder: Path, *, model: str = "sparse/0", raw_images: bool = False) -> Path:
    """`{rgb,thermal}/{train,test}/<view>.jpg` where the model says .png; the first of 8 views is a test view."""
    write_model(scene, folder / model, "PINHOLE", ".png")
    for number, view in enumerate(scene.views):
        part = "test" if number % 8 == 0 else "train"
        for kind, image in (("rgb", view.rgb), ("thermal", view.thermal)):
            (folder / kind / part).mkdir(parents=True, exist_ok=True)
            _picture(image).convert("RGB").save(folder / kind / part / f"{view.name}.jpg", quality=95)
        if raw_images:
            (folder / "raw_images").mkdir(exist_ok=True)
            counts = FlirCamera().counts(celsius(view, scene))
            write_flir(folder / "raw_images" / f"{view.name}.jpg", counts)
    return folder


def write_thermoscenes(
    scene: Scene, folder: Path, *, file: str = "transforms.json", per_frame: bool = False, lists: bool = False,
    names_thermal: bool = True, points: str | None = "saved",
) -> Path:  # fmt: skip
    """`transforms.json`, `images/`, `thermal/`, `temperature_bounds.json`, and `sparse_pc.ply` in its world.

    per_frame: intrinsics in each frame. lists: the split as lists, not in file names. points: `saved`, as nerfstudio 1
    writes them; `original`, as before; None: no file.
    """
    world = np.vstack([APPLIED, [0, 0, 0, 1]])
    for sub in ("images", "thermal"):
        (folder / sub).mkdir(parents=True)
    camera, frames, split = scene.views[0].camera, [], {"train": [], "test": []}
    intrinsics = {
        "w": camera.width, "h": camera.height, "fl_x": camera.K[0, 0], "fl_y": camera.K[1, 1], "cx": camera.K[0, 2],
        "cy": camera.K[1, 2], "k1": 0.02, "k2": 0.0, "p1": 0.001, "p2": 0.0, "camera_model": "OPENCV",
    }  # fmt: skip
    for number, view in enumerate(scene.views):
        part = "test" if number % 5 == 0 else "train"
        name = view.name if lists else f"frame_{'eval' if part == 'test' else 'train'}_{number:04d}"
        _picture(view.rgb).save(folder / "images" / f"{name}.jpg", quality=95)
        _picture(view.thermal).convert("L").save(folder / "thermal" / f"{name}.png")
        to_world = world @ np.linalg.inv(view.camera.world_to_camera) @ OPENGL_TO_OPENCV
        frame = {"file_path": f"images/{name}.jpg", "transform_matrix": to_world.tolist()}
        frame |= {"thermal_file_path": f"thermal/{name}.png"} if names_thermal else {}
        frames.append(frame | (intrinsics if per_frame else {}))
        split[part].append(frame["file_path"])
    content = {**({} if per_frame else intrinsics), "frames": frames, "applied_transform": APPLIED.tolist()}
    content |= {f"{part}_filenames": paths for part, paths in split.items()} if lists else {}
    if points is not None:
        content["ply_file_path"] = "sparse_pc.ply"
        xyz = scene.points.points @ APPLIED[:, :3].T if points == "saved" else scene.points.points
        write_ply(folder / "sparse_pc.ply", xyz, scene.points.colors)
    (folder / file).write_text(json.dumps(content, indent=4), encoding="utf-8")
    span = scene.temperature
    bounds = {"absolute_max_temperature": span.max, "absolute_min_temperature": span.min}
    (folder / "temperature_bounds.json").write_text(json.dumps(bounds), encoding="utf-8")
    return folder


def write_sear(scene: Scene, folder: Path, registered: bool = True) -> Path:
    """`transforms.json` of pairs, `images/`, `thermal/`. registered: whether RGB and thermal images have one camera."""
    frames = []
    for view in scene.views:
        K, camera = view.camera.K, view.camera
        numbers = {"w": camera.width, "h": camera.height, "fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2],
                   "cy": K[1, 2], "fovx": 60.0, "transform_matrix": camera.world_to_camera[:3].tolist()}  # fmt: skip
        pair = {}
        for kind, place, image in (("rgb", "images", view.rgb), ("thermal", "thermal", view.thermal)):
            (folder / place).mkdir(parents=True, exist_ok=True)
            _picture(image).save(folder / place / f"{view.name}.png")
            pair[kind] = {**numbers, "file_path": f"{place}/{view.name}.png", "type": kind}
        pair["rgb"] |= {} if registered else {"fl_x": 2 * K[0, 0]}
        frames.append(pair)
    (folder / "transforms.json").write_text(json.dumps({"type": "oru", "frames": frames}, indent=4), encoding="utf-8")
    return folder


def write_ti_nsd(scene: Scene, folder: Path) -> Path:
    """`images/` of thermal images alone, `sparse/0`."""
    write_model(scene, folder / "sparse" / "0", "PINHOLE", ".png")
    (folder / "images").mkdir()
    for view in scene.views:
        _picture(view.thermal).save(folder / "images" / f"{view.name}.png")
    return folder


def write_mask(folder: Path, name: str, valid: np.ndarray) -> None:
    """`masks/<view>.png` of valid pixels (H, W) bool."""
    (folder / "masks").mkdir(exist_ok=True)
    Image.fromarray(np.where(valid, 255, 0).astype(np.uint8)).save(folder / "masks" / f"{name}.png")


def write_model(scene: Scene, folder: Path, camera: str, suffix: str) -> None:
    """A binary COLMAP model of a scene's views, and of the view LOST, with a camera of the given model."""
    first = scene.views[0].camera
    posed = [*((view.name, view.camera) for view in scene.views), (LOST, first)]
    write_pinholes(folder, [(f"{name}{suffix}", one) for name, one in posed], scene.points)
    if camera != "PINHOLE":
        model = pycolmap.Reconstruction(str(folder))
        (one,) = model.cameras.values()
        focal = first.K.diagonal()[: 1 if camera.startswith("SIMPLE") else 2]
        one.model, one.params = getattr(pycolmap.CameraModelId, camera), [*focal, *first.K[:2, 2], *DISTORTIONS[camera]]
        model.write_binary(str(folder))


def write_stored(scene: Scene, folder: Path, stored: Callable[[np.ndarray], np.ndarray], suffix: str = ".tiff") -> Path:
    """Write a scene whose thermal images are what `stored` makes of a view's temperatures (H, W)."""
    write_model(scene, folder / "sparse" / "0", "PINHOLE", ".png")
    (folder / "thermal").mkdir()
    for view in scene.views:
        Image.fromarray(stored(celsius(view, scene))).save(folder / "thermal" / f"{view.name}{suffix}")
    return folder


def write_ply(path: Path, xyz: np.ndarray, colors: np.ndarray) -> None:
    """Points as nerfstudio's `create_ply_from_colmap` writes them: text, float positions, 8-bit colours."""
    columns = [*((axis, "f4") for axis in "xyz"), *((channel, "u1") for channel in ("red", "green", "blue"))]
    rows = np.array([(*p, *c) for p, c in zip(xyz, np.round(colors * 255), strict=True)], columns)
    PlyData([PlyElement.describe(rows, "vertex")], text=True).write(path)


@dataclass(frozen=True)
class Shipped:
    """What scenes in a layout are shipped with. layout: a key of `tdgbench.scenes.layouts.LAYOUTS`."""

    write: Callable[[Scene, Path], Path]
    layout: str
    dataset: str
    has_rgb: bool = True
    in_celsius: bool = True
    has_points: bool = True


LAYOUTS = {
    "thermalmix": Shipped(write_thermalmix, "thermalmix", "folder"),
    "thermalmix_images": Shipped(partial(write_downloaded_thermalmix, states_range=True), "thermalmix", "folder"),
    "rgbt_scenes": Shipped(write_rgbt_scenes, "rgbt_scenes", "folder", in_celsius=False),
    "thermoscenes": Shipped(write_thermoscenes, "thermoscenes", "thermoscenes"),
    "sear": Shipped(write_sear, "sear", "sear", in_celsius=False, has_points=False),
    "ti_nsd": Shipped(write_ti_nsd, "ti_nsd", "ti_nsd", has_rgb=False, in_celsius=False),
}


def _picture(image: np.ndarray) -> Image.Image:
    levels = np.round(image * 255).astype(np.uint8)
    return Image.fromarray(levels[..., 0] if levels.shape[2] == 1 else levels)

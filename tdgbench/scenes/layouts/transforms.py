"""nerfstudio's transforms.json: cameras and poses of frames, and the files that they name.

Facts: nerfstudio 1.1, nerfstudio/data/dataparsers/nerfstudio_dataparser.py and nerfstudio/process_data/colmap_utils.py.
A key of the file as a whole goes before that of a frame. `transform_matrix` is camera to world in OpenGL's axes (x
right, y up, z backward). Intrinsics are COLMAP's: pixel centres are at integers + 1/2.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from tdgbench.scenes.colmap import RegisteredImage
from tdgbench.scenes.colmap.pinhole import to_pinhole
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_view_name, read_json
from tdgbench.scenes.scene import Camera
from tdgbench.scenes.temperature import finite_number
from tdgbench.scenes.validate import check_camera, check_pose

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])  # axes of a camera
PERSPECTIVE = (None, "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")
FISHEYE = "OPENCV_FISHEYE"
SPLITS = ("train", "val", "test")


@dataclass(frozen=True)
class TransformsFrame:
    """A frame of transforms.json. Paths are relative to its folder."""

    posed: RegisteredImage
    file: Path
    thermal_file: Path | None


@dataclass(frozen=True)
class Transforms:
    """Content of a transforms.json, frames by view name."""

    frames: dict[str, TransformsFrame]
    lists: dict[str, list[str]]  # view names by split, of SPLITS
    points: Path | None  # of a .ply file, relative to its folder
    applied_transform: np.ndarray | None  # (4, 4), from the original world to that of the frames


def read_transforms(path: Path) -> Transforms:
    """Read a transforms.json. Raises SceneError naming the frame and the remedy."""
    content = _content(path)
    cameras: dict[CameraEntry, Any] = {}
    frames: dict[str, TransformsFrame] = {}
    for number, frame in enumerate(content["frames"]):
        where = f"{path}: frame {number}"
        if not isinstance(frame, dict):
            raise SceneError(f"{where} is no object with file_path and transform_matrix. Correct the file")
        file = _inside(frame.get("file_path"), "file_path", where)
        name = check_view_name(file.stem, where)
        if name in frames:
            raise SceneError(f"{where} and another one are both view {name}; view names must be unique in a scene")
        where = f"{path}: frame {name}"
        entry = _camera_entry({**frame, **{k: v for k, v in content.items() if k != "frames"}}, where)
        if entry not in cameras:
            cameras[entry] = to_pinhole(entry, where)
        pinhole, _, undistortion = cameras[entry]
        camera = Camera(pinhole.K, _pose(frame, where), pinhole.width, pinhole.height)
        thermal = frame.get("thermal_file_path")
        frames[name] = TransformsFrame(
            RegisteredImage(name, check_camera(camera, where), undistortion),
            file,
            None if thermal is None else _inside(thermal, "thermal_file_path", where),
        )
    ply = content.get("ply_file_path")
    return Transforms(
        frames,
        _lists(content, path),
        None if ply is None else _inside(ply, "ply_file_path", str(path)),
        _applied(content, path),
    )


def _content(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path)
    except (ValueError, RecursionError) as error:
        raise SceneError(f"{path} is no JSON: {error}; copy or download it again") from error
    if not isinstance(content, dict) or not isinstance(content.get("frames"), list) or not content["frames"]:
        raise SceneError(f"{path} has no list of `frames`; it must be a transforms.json of nerfstudio")
    return content


def _inside(value: Any, key: str, where: str) -> Path:
    """Return a path relative to the scene's folder."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise SceneError(f"{where} has no {key}, the path of a file relative to the scene's folder. Correct the file")
    path = PurePosixPath(value.replace("\\", "/"))
    if path.is_absolute() or ".." in path.parts:
        raise SceneError(f"{where} has the {key} {value}, which is not inside the scene's folder. Correct the file")
    return Path(path)


def _number(values: dict[str, Any], key: str, where: str, default: float | None = None) -> float:
    value = values.get(key, default)
    try:
        if value is None:
            raise KeyError(key)
        return finite_number(value)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        what = f"has {key} {value!r}" if key in values else f"has no {key}"
        raise SceneError(f"{where} {what}; it must be a finite number, of the file or of each frame") from error


def _camera_entry(values: dict[str, Any], where: str) -> CameraEntry:
    """Return COLMAP's camera of a frame."""
    fx, fy, cx, cy, width, height = (_number(values, key, where) for key in ("fl_x", "fl_y", "cx", "cy", "w", "h"))
    k1, k2, k3, k4, p1, p2 = (_number(values, key, where, 0.0) for key in ("k1", "k2", "k3", "k4", "p1", "p2"))
    if width != round(width) or height != round(height):
        raise SceneError(f"{where} has w {width:g} and h {height:g}; they must be whole numbers of pixels")
    model = values.get("camera_model")
    if model not in (*PERSPECTIVE, FISHEYE) or (model != FISHEYE and k4 != 0):
        what = f"camera_model {model}" if model not in (*PERSPECTIVE, FISHEYE) else f"k4 {k4:g}"
        raise SceneError(f"{where} has the {what}, which is not supported; undistort the images, or use {FISHEYE}")
    distortion: tuple[float, ...] = ()
    if model == FISHEYE:
        kind, distortion = FISHEYE, (k1, k2, k3, k4)
    elif k3 != 0:
        kind, distortion = "FULL_OPENCV", (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
    elif (k1, k2, p1, p2) != (0, 0, 0, 0):
        kind, distortion = "OPENCV", (k1, k2, p1, p2)
    else:
        kind = "PINHOLE"
    return CameraEntry(1, kind, int(width), int(height), (fx, fy, cx, cy, *distortion))


def _matrix(value: Any, what: str, where: str) -> np.ndarray:
    """Return a matrix (4, 4), whose last row may be left out."""
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise SceneError(f"{where} has no {what} of 4×4 finite numbers. Correct the file")
    return matrix if len(matrix) == 4 else np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])


def _pose(frame: dict[str, Any], where: str) -> np.ndarray:
    """Return world to camera (4, 4) in OpenCV's axes."""
    to_world = _matrix(frame.get("transform_matrix"), "transform_matrix", where)
    check_pose(to_world, where)
    rotation = to_world[:3, :3] @ OPENGL_TO_OPENCV[:3, :3]
    pose = np.eye(4)
    pose[:3, :3] = rotation.T
    pose[:3, 3] = -rotation.T @ to_world[:3, 3]
    return pose


def _applied(content: dict[str, Any], path: Path) -> np.ndarray | None:
    value = content.get("applied_transform")
    return None if value is None else _matrix(value, "applied_transform", str(path))


def _lists(content: dict[str, Any], path: Path) -> dict[str, list[str]]:
    """Return view names by split; none where the file has no lists."""
    found = {}
    for split in SPLITS:
        names = content.get(f"{split}_filenames")
        if names is None:
            continue
        if not isinstance(names, list):
            raise SceneError(f"{path}: {split}_filenames is no list of paths. Correct the file")
        found[split] = [_inside(name, f"{split}_filenames", str(path)).stem for name in names]
    return found

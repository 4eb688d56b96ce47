"""nerfstudio's transforms.json: cameras and poses of frames, the files that they name, and the points of a PLY file.

Facts: nerfstudio 1.1, nerfstudio/data/dataparsers/nerfstudio_dataparser.py and nerfstudio/process_data/colmap_utils.py.
A key of the file as a whole goes before that of a frame. `transform_matrix` is camera to world in OpenGL's axes (x
right, y up, z backward). Intrinsics are COLMAP's: pixel centres are at integers + 1/2.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, PlainValidator, ValidationError

from tdgbench.ply import read_ply
from tdgbench.scenes.colmap import RegisteredImage
from tdgbench.scenes.colmap.pinhole import to_pinhole
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_view_name, decoding, read_bytes, read_json
from tdgbench.scenes.scene import Camera, PointCloud, pose_at
from tdgbench.scenes.validate import MAX_COORDINATE, check_camera, check_pose
from tdgbench.text import shortened

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0])  # axes of a camera
FISHEYE = "OPENCV_FISHEYE"
SPLITS = ("train", "val", "test")
CameraModel = Literal["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"]
M = TypeVar("M", bound=BaseModel)
REMEDY = "copy or download it again, or remove it and use init=random"
CLEARLY_MORE = 0.02  # of the points, that are in some image in one world and in none in the other


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


def _inside(value: object) -> Path:
    """Return a path relative to the scene's folder."""
    path = PurePosixPath(value.replace("\\", "/")) if isinstance(value, str) else PurePosixPath()
    if not path.parts or path.is_absolute() or ".." in path.parts or "\0" in str(path):
        raise ValueError("it must be the path of a file inside the scene's folder")
    return Path(path)


def _matrix(value: object) -> np.ndarray:
    """Return a matrix (4, 4), whose last row may be left out."""
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.empty(0)
    if matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix).all():
        raise ValueError("it must be 4×4 finite numbers")
    return matrix if len(matrix) == 4 else np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])


RelativePath = Annotated[Path, PlainValidator(_inside)]
Matrix = Annotated[np.ndarray, PlainValidator(_matrix)]


class _File(BaseModel):
    frames: Annotated[list[dict[str, object]], Field(min_length=1)]
    train_filenames: list[RelativePath] | None = None
    val_filenames: list[RelativePath] | None = None
    test_filenames: list[RelativePath] | None = None
    ply_file_path: RelativePath | None = None
    applied_transform: Matrix | None = None


class _Frame(BaseModel):
    file_path: RelativePath
    thermal_file_path: RelativePath | None = None
    transform_matrix: Matrix


class _Intrinsics(BaseModel):
    fl_x: FiniteFloat
    fl_y: FiniteFloat
    cx: FiniteFloat
    cy: FiniteFloat
    w: int
    h: int
    k1: FiniteFloat = 0.0
    k2: FiniteFloat = 0.0
    k3: FiniteFloat = 0.0
    k4: FiniteFloat = 0.0
    p1: FiniteFloat = 0.0
    p2: FiniteFloat = 0.0
    camera_model: CameraModel | None = None


def read_transforms(path: Path) -> Transforms:
    """Read a transforms.json. Raises SceneError naming the frame and the remedy."""
    with decoding(path, "JSON", "copy or download it again"):
        content = read_json(path)
    file = _parsed(_File, content, str(path))
    cameras = {}
    frames: dict[str, TransformsFrame] = {}
    for number, values in enumerate(file.frames):
        where = f"{path}: frame {number}"
        frame = _parsed(_Frame, values, where)
        name = check_view_name(frame.file_path.stem, where)
        if name in frames:
            raise SceneError(f"{where} and another one are both view {name}; view names must be unique in a scene")
        where = f"{path}: frame {name}"
        entry = _camera_entry(_parsed(_Intrinsics, {**values, **content}, where), where)
        if entry not in cameras:
            cameras[entry] = to_pinhole(entry, where)
        pinhole, undistortion = cameras[entry]
        to_world = frame.transform_matrix
        check_pose(to_world, where)
        pose = pose_at(to_world[:3, 3], (to_world[:3, :3] @ OPENGL_TO_OPENCV).T)
        camera = Camera(pinhole.K, pose, pinhole.width, pinhole.height)
        posed = RegisteredImage(name, check_camera(camera, where), undistortion)
        frames[name] = TransformsFrame(posed, frame.file_path, frame.thermal_file_path)
    lists = {split: getattr(file, f"{split}_filenames") for split in SPLITS}
    stems = {split: [name.stem for name in names] for split, names in lists.items() if names is not None}
    return Transforms(frames, stems, file.ply_file_path, file.applied_transform)


def _parsed(kind: type[M], values: object, where: str) -> M:
    """Return values as a model of pydantic. Raises SceneError naming the first key that is wrong."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        key = first["loc"][0] if first["loc"] else "content"
        what = f"has the {key} {shortened(repr(first['input']), 60)}: {first['msg']}"
        what = f"has no {key}" if first["type"] == "missing" else what
        raise SceneError(f"{where} {what}. Correct the file, a transforms.json of nerfstudio") from error


def _camera_entry(camera: _Intrinsics, where: str) -> CameraEntry:
    """Return COLMAP's camera of a frame."""
    k1, k2, k3, p1, p2 = camera.k1, camera.k2, camera.k3, camera.p1, camera.p2
    model: str = "PINHOLE"
    distortion: tuple[float, ...] = ()
    if camera.camera_model == FISHEYE:
        model, distortion = FISHEYE, (k1, k2, k3, camera.k4)
    elif camera.k4 != 0:
        raise SceneError(f"{where} has the k4 {camera.k4:g}, which only {FISHEYE} has; undistort the images")
    elif k3 != 0:
        model, distortion = "FULL_OPENCV", (k1, k2, p1, p2, k3, 0.0, 0.0, 0.0)
    elif (k1, k2, p1, p2) != (0, 0, 0, 0):
        model, distortion = "OPENCV", (k1, k2, p1, p2)
    return CameraEntry(1, model, camera.w, camera.h, (camera.fl_x, camera.fl_y, camera.cx, camera.cy, *distortion))


def read_points(path: Path) -> PointCloud:
    """Read vertices of a PLY file with x, y, z and, where it has them, red, green, blue. Raises SceneError."""
    with decoding(path, "a point cloud", REMEDY):
        vertex = read_ply(io.BytesIO(read_bytes(path)))["vertex"]
        xyz = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=-1)
        names = {prop.name for prop in vertex.properties}
        colors = np.full(xyz.shape, 0.5, np.float32)
        if {"red", "green", "blue"} <= names:
            channels = [np.asarray(vertex[channel]) for channel in ("red", "green", "blue")]
            scale = 255 if all(channel.dtype.kind in "iu" for channel in channels) else 1
            colors = np.stack(channels, axis=-1).astype(np.float32) / np.float32(scale)
    if not (np.abs(xyz) <= MAX_COORDINATE).all() or not ((colors >= 0) & (colors <= 1)).all():  # NaN included
        raise SceneError(f"{path} has points or colours that are not finite, or beyond {MAX_COORDINATE:g}; {REMEDY}")
    return PointCloud(xyz, colors)


def where_they_are(
    cloud: PointCloud, applied_transform: np.ndarray | None, cameras: list[Camera]
) -> tuple[PointCloud, bool]:
    """Return the points in the world of nerfstudio's frames, and whether they had to be moved there.

    nerfstudio writes points in that world since its release 1.0 (`create_ply_from_colmap` of
    nerfstudio/process_data/colmap_utils.py takes the applied_transform, (4, 4)); before, it wrote COLMAP's own
    (nerfstudio_dataparser.py at 01595f7 still applied it on reading). COLMAP's points are seen in two images at least,
    so the world decides in which more points are in an image.
    """
    if applied_transform is None or not len(cloud.points):
        return cloud, False
    moved = cloud.points @ applied_transform[:3, :3].T + applied_transform[:3, 3]
    if _share_in_images(moved, cameras) > _share_in_images(cloud.points, cameras) + CLEARLY_MORE:
        return replace(cloud, points=moved), True
    return cloud, False


def _share_in_images(points: np.ndarray, cameras: list[Camera]) -> float:
    """Return the share of the points (N, 3) that lie in front of a camera and in its image."""
    seen = np.zeros(len(points), bool)
    for camera in cameras:
        seen |= camera.shows(points)
    return float(seen.mean())

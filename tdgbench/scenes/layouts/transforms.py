"""nerfstudio's transforms.json: cameras and poses of frames, the files that they name, and the points of a PLY file.

Facts: nerfstudio 50e0e3c, nerfstudio/data/dataparsers/nerfstudio_dataparser.py and nerfstudio/process_data/
colmap_utils.py; NVlabs/instant-ngp 090aed6, src/nerf_loader.cu. `transform_matrix` is camera to world in OpenGL's axes
(x right, y up, z backward). Intrinsics are COLMAP's: pixel centres are at integers + 1/2. A key of the file as a whole
is that of every frame; where a frame has another value, nerfstudio takes the file's and instant-ngp the frame's, so it
is refused. instant-ngp's `is_fisheye` makes k1 to k4 those of OPENCV_FISHEYE; without them it is a pinhole there.
"""

from __future__ import annotations

import io
import math
import re
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, PlainValidator, ValidationError

from tdgbench.ply import read_ply
from tdgbench.scenes.camera import MAX_COORDINATE, Camera, check_camera, check_pose, pose_at
from tdgbench.scenes.colmap import RegisteredImage
from tdgbench.scenes.colmap.pinhole import to_pinhole
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import SUFFIXES, header
from tdgbench.scenes.inputs import decoding, is_there, read_bytes, read_json
from tdgbench.scenes.names import key, pair, view_names
from tdgbench.scenes.registry import plain_name
from tdgbench.scenes.scene import PointCloud
from tdgbench.text import shortened

OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0])  # axes of a camera
FISHEYE = "OPENCV_FISHEYE"
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
PERSPECTIVE = ("PINHOLE", "OPENCV", "FULL_OPENCV")  # the first that has all parameters that are not 0 is taken
PARAMETERS = {  # after the principal point, as COLMAP has them; -: 0, as k4 is a fisheye's in these files
    "PINHOLE": (),
    "OPENCV": ("k1", "k2", "p1", "p2"),
    "FULL_OPENCV": ("k1", "k2", "p1", "p2", "k3", "-", "-", "-"),
    FISHEYE: ("k1", "k2", "k3", "k4"),
}  # type: dict[str, tuple[str, ...]]
# Keys that change cameras or pixels and are not honoured: refused unless they are 0, false or empty. Others, such as
# scale, aabb_scale or orientation_override, change the world of poses and points alike, or nothing that is read here.
REFUSED = (
    *("k5", "k6", "omega", "b1", "b2", "skew", "distortion_params", "distortion", "fisheye", "fisheye_crop_radius"),
    *("x_fov", "y_fov", "latlong", "equirectangular", "rolling_shutter", "normal_mts_args", "sharpen"),
    *("transform_matrix_start", "transform_matrix_end", "white_transparent", "black_transparent"),
    *(f"ftheta_p{i}" for i in range(5)),
)  # fmt: skip
KINDS = ("lens", "lens_model", "lens_type", "projection", "projection_type", "camera_type", "distortion_model")
NO_PINHOLE = re.compile("fish|equirect|spher|ortho|pano|omni|360", re.IGNORECASE)  # in a text of KINDS
SPLITS = ("train", "val", "test")
POINTS = "sparse_pc.ply"  # nerfstudio's default
CameraModel = Literal["PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE"]
M = TypeVar("M", bound=BaseModel)
REMEDY = "copy or download it again, or remove it and use init=random"
CLEARLY_MORE = 0.02  # of the points, that are in some image in one world and in none in the other
CHANNELS = ("red", "green", "blue")
ROUNDING = 1e-3  # by which floats of colours to 1 may be above it


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
    applied_scale: FiniteFloat = 1.0


class Frame(BaseModel):
    """A frame of a transforms.json."""

    file_path: RelativePath
    thermal_file_path: RelativePath | None = None
    mask_path: RelativePath | None = None
    transform_matrix: Matrix


class _Intrinsics(BaseModel):
    w: int
    h: int
    fl_x: FiniteFloat | None = None
    fl_y: FiniteFloat | None = None
    cx: FiniteFloat | None = None
    cy: FiniteFloat | None = None
    camera_angle_x: FiniteFloat | None = None  # radians
    camera_angle_y: FiniteFloat | None = None
    k1: FiniteFloat = 0.0
    k2: FiniteFloat = 0.0
    k3: FiniteFloat = 0.0
    k4: FiniteFloat = 0.0
    p1: FiniteFloat = 0.0
    p2: FiniteFloat = 0.0
    camera_model: CameraModel | None = None
    is_fisheye: bool = False


KNOWN = {plain_name(name): name for kind in (_File, Frame, _Intrinsics) for name in kind.model_fields}
KNOWN |= {plain_name(name): name for name in REFUSED}


@dataclass(frozen=True)
class Transforms:
    """Content of a transforms.json; poses and frames by view name."""

    posed: dict[str, RegisteredImage]
    frames: dict[str, Frame]
    lists: dict[str, list[str]]  # view names by split, of SPLITS
    points: Path | None  # of a .ply file, relative to its folder
    applied_transform: np.ndarray | None  # (4, 4), from the original world to the frames'
    assumed: dict[str, str]  # as of Scene


def read_transforms(path: Path) -> Transforms:
    """Read a transforms.json. Raises SceneError naming the frame and the remedy."""
    with decoding(path, "JSON", "copy or download it again"):
        content = read_json(path)
    file = _parsed(_File, content, str(path))
    _check_keys(content, str(path))
    pairs = is_of_pairs(file.frames[0])
    if pairs:
        file.frames = [_frame_of_pair(frame, f"{path}: frame {number}") for number, frame in enumerate(file.frames)]
    if file.applied_scale != 1 and (file.ply_file_path is not None or is_there(path.parent / POINTS)):
        raise SceneError(
            f"{path} has the applied_scale {file.applied_scale:g}, which programs apply to points in different ways: "
            f"remove the key, and the points unless they are in the cameras' world; then use init=random"
        )
    parsed = [_parsed(Frame, values, f"{path}: frame {number}") for number, values in enumerate(file.frames)]
    names = view_names([key(str(frame.file_path)) for frame in parsed], str(path))
    pinholes: dict[CameraEntry, tuple] = {}
    posed: dict[str, RegisteredImage] = {}
    assumed: set[str] = set()
    for frame, values, (one, name) in zip(parsed, file.frames, names.items(), strict=True):
        where = f"{path}: frame {name}"
        lens, missing = _lens(content, values, path.parent / frame.file_path, where)
        assumed |= missing
        if lens not in pinholes:
            pinholes[lens] = to_pinhole(lens, where)
        pinhole, undistortion = pinholes[lens]
        to_world = frame.transform_matrix
        check_pose(to_world, where)
        pose = pose_at(to_world[:3, 3], (to_world[:3, :3] @ OPENGL_TO_OPENCV).T)
        camera = check_camera(replace(pinhole, world_to_camera=pose), where)
        posed[name] = RegisteredImage(name, camera, undistortion, one)
    views = {name: one for one, name in names.items()}
    lists = {split: getattr(file, f"{split}_filenames") for split in SPLITS}
    parts = {split: _listed(paths, views, path) for split, paths in lists.items() if paths is not None}
    said = {"intrinsics": f"{', '.join(sorted(assumed))}: {path.name} does not say it"} if assumed else {}
    said |= {"cameras": "SEAR's of each thermal image, world to camera"} if pairs else {}
    frames = dict(zip(posed, parsed, strict=True))
    return Transforms(posed, frames, parts, file.ply_file_path, file.applied_transform, said)


def is_of_pairs(frame: dict[str, object]) -> bool:
    """Return whether a frame is a pair of images with a camera each, as of Schindler-EPFL-Lab/SEAR 7a2e71b."""
    return isinstance(frame.get("rgb"), dict) and isinstance(frame.get("thermal"), dict)


def _frame_of_pair(frame: dict[str, object], where: str) -> dict[str, object]:
    """Return the thermal image of a pair as nerfstudio's frame, with its RGB image if both have one camera.

    SEAR's `transform_matrix` is world to camera in OpenCV's axes. Raises SceneError.
    """
    if not is_of_pairs(frame):
        raise SceneError(f"{where} has no rgb and thermal image, as the first frame has. Correct the file")
    rgb, own = dict(frame["rgb"]), dict(frame["thermal"])  # type: ignore[call-overload]
    with decoding(Path(where), "a pair of SEAR", "copy or download it again"):
        to_world = np.linalg.inv(_matrix(own.get("transform_matrix")))
        to_world[:3, :3] = to_world[:3, :3] @ OPENGL_TO_OPENCV
    camera = {"transform_matrix", *_Intrinsics.model_fields}
    is_registered = all(rgb.get(name) == own.get(name) for name in camera)
    image = rgb.get("file_path") if is_registered else own.get("file_path")
    return {**own, "transform_matrix": to_world.tolist(), "thermal_file_path": own.get("file_path"), "file_path": image}


def there(path: Path) -> Path | None:
    """Return a file, also if its name lacks the extension, as instant-ngp has it; None if there is none."""
    names = [path.name, *(path.name + suffix for suffix in SUFFIXES)]
    return next((path.with_name(name) for name in names if is_there(path.with_name(name))), None)


def _listed(paths: list[Path], views: dict[str, str], where: Path) -> list[str]:
    """Return the views of a split's list, whose keys are `views`. Raises SceneError for an unknown one."""
    keys = dict.fromkeys(key(str(path)) for path in paths)
    found = {file: view for view, file in pair(keys, views, str(where)).items()}
    unknown = [one for one in keys if one not in found]
    if unknown:
        raise SceneError(f"{where} lists {unknown[0]} in its split, but has no such frame. Correct the list")
    return [found[one] for one in keys]


def _check_keys(values: dict[str, object], where: str) -> None:
    """Raise SceneError for a key that changes cameras or pixels and is not honoured, or is spelled in another way."""
    for name, value in values.items():
        is_set = any(value) if isinstance(value, list) else bool(value)
        if (name in REFUSED and is_set) or (name in KINDS and NO_PINHOLE.search(str(value))):
            said = shortened(repr(value), 60)
            raise SceneError(
                f"{where} has the {name} {said}, which changes cameras or pixels and is not read here; undistort the "
                "images, or remove the key if it means nothing"
            )
        known = KNOWN.get(plain_name(name), name)
        if known != name and is_set:
            raise SceneError(f"{where} has the key {name!r}; if it is {known}, rename it, else remove it")


def _stated(content: dict[str, object], frame: dict[str, object], where: str) -> dict[str, object]:
    """Return the intrinsics of a frame: its own, and the file's. Raises SceneError where they contradict each other."""
    common = {name: content[name] for name in _Intrinsics.model_fields if name in content}
    if any(name in common for name in DISTORTION):  # nerfstudio reads all from the file then
        common = dict.fromkeys(DISTORTION, 0.0) | common
    for name in sorted(common.keys() & frame.keys()):
        own, value = frame[name], common[name]
        numbers = isinstance(own, int | float) and isinstance(value, int | float)
        if own != value and not (numbers and math.isclose(own, value, rel_tol=1e-6)):  # type: ignore[arg-type]
            raise SceneError(
                f"{where} has the {name} {shortened(repr(own), 30)}, the file as a whole {shortened(repr(value), 30)}: "
                "nerfstudio takes the file's, instant-ngp the frame's; remove the wrong one"
            )
    return {**frame, **common}


def _parsed(kind: type[M], values: object, where: str) -> M:
    """Return values as a model of pydantic. Raises SceneError naming the first key that is wrong."""
    try:
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        name = first["loc"][0] if first["loc"] else "content"
        what = f"has the {name} {shortened(repr(first['input']), 60)}: {first['msg']}"
        what = f"has no {name}" if first["type"] == "missing" else what
        raise SceneError(f"{where} {what}. Correct the file, a transforms.json of nerfstudio") from error


def _lens(
    content: dict[str, object], frame: dict[str, object], image: Path, where: str
) -> tuple[CameraEntry, set[str]]:
    """Return COLMAP's camera of a frame, and what is missing in the file, which is as instant-ngp has it."""
    _check_keys(frame, where)
    stated, missing = _stated(content, frame, where), set()
    if {"w", "h"}.isdisjoint(stated) and (file := there(image)) is not None:
        size = header(file, as_picture=True)
        stated |= {"w": size.width, "h": size.height}
        missing.add("w and h are the image's")
    camera = _parsed(_Intrinsics, stated, where)
    given = (camera.fl_x, camera.camera_angle_x, camera.w), (camera.fl_y, camera.camera_angle_y, camera.h)
    fx, fy = (size / (2 * math.tan(angle / 2)) if focal is None and angle else focal for focal, angle, size in given)
    if fx is None:
        raise SceneError(f"{where} has no fl_x and no camera_angle_x. Correct the file, a transforms.json")
    known = {"fl_y is fl_x": fy, "cx is the centre": camera.cx, "cy is the centre": camera.cy}
    usual = fx, camera.w / 2, camera.h / 2
    params = [least if value is None else value for value, least in zip(known.values(), usual, strict=True)]
    missing |= {what for what, value in known.items() if value is None}
    model, distortion = _distortion(camera, where)
    return CameraEntry(1, model, camera.w, camera.h, (fx, *params, *distortion)), missing


def _distortion(camera: _Intrinsics, where: str) -> tuple[str, tuple[float, ...]]:
    """Return COLMAP's model, and its parameters after the principal point."""
    values = {name: getattr(camera, name) for name in DISTORTION}
    used, stated = {name for name, value in values.items() if value != 0}, camera.camera_model
    if camera.is_fisheye and stated != FISHEYE and (stated is not None or not used & {*PARAMETERS[FISHEYE]}):
        other = stated or "a pinhole to instant-ngp, without k1 to k4"
        raise SceneError(f"{where} is_fisheye and {other}; state the camera_model {FISHEYE}, or remove is_fisheye")
    fitting = (model for model in PERSPECTIVE if used <= {*PARAMETERS[model]})
    model = FISHEYE if camera.is_fisheye or stated == FISHEYE else next(fitting, PERSPECTIVE[-1])
    if unknown := sorted(used - {*PARAMETERS[model]}):
        what = f"{unknown[0]} {values[unknown[0]]:g}, which {model} has not"
        raise SceneError(f"{where} has the {what}; undistort the images, or state the right camera_model")
    return model, tuple(values.get(name, 0.0) for name in PARAMETERS[model])


def read_points(path: Path) -> tuple[PointCloud, str]:
    """Read vertices of a PLY file with x, y, z and, where it has them, colours; and say how these were read.

    Floats up to 1 are the colours; else they go to 255, or to 65 535 where one is higher. Raises SceneError.
    """
    with decoding(path, "a point cloud", REMEDY):
        vertex = read_ply(io.BytesIO(read_bytes(path)))["vertex"]
        xyz = np.stack([np.asarray(vertex[axis], np.float64) for axis in "xyz"], axis=-1)
        names = {prop.name for prop in vertex.properties}
        prefix = next((one for one in ("", "diffuse_") if {one + channel for channel in CHANNELS} <= names), None)
        colors, said = np.full(xyz.shape, 0.5, np.float32), ""
        if prefix is not None:
            stored = np.stack([np.asarray(vertex[prefix + channel]) for channel in CHANNELS], axis=-1)
            highest, is_float = stored.max(initial=0), stored.dtype.kind == "f"
            most = 1 if is_float and highest <= 1 + ROUNDING else 255 if highest <= 255 else 65535
            colors = stored.astype(np.float32) / np.float32(most)
            said = "" if stored.dtype == np.uint8 else f"{stored.dtype}, 0 to {most}"
    good = {
        f"a point that is not finite or beyond {MAX_COORDINATE:g}": np.abs(xyz) <= MAX_COORDINATE,
        "a colour that is not finite, negative or above 65535": (colors >= 0) & (colors <= 1 + ROUNDING),
    }
    for what, values in good.items():
        if not values.all():
            raise SceneError(f"{path}: vertex {np.argwhere(~values)[0, 0]} has {what}; remove it, or {REMEDY}")
    return PointCloud(xyz, np.minimum(colors, 1)), said


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
    return float(reduce(np.logical_or, (camera.shows(points) for camera in cameras)).mean())

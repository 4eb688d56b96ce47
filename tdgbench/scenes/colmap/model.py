"""Read a COLMAP model, binary or text: registered images with checked pinhole cameras, sparse points; and write one."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap

from tdgbench.scenes.camera import MAX_COORDINATE, Camera, check_camera
from tdgbench.scenes.colmap import binary, text
from tdgbench.scenes.colmap.pinhole import Undistortion, to_pinhole
from tdgbench.scenes.colmap.tables import REMEDY, CameraEntry, DamagedModelError, ImageEntry, Points
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import is_there
from tdgbench.scenes.names import key, of_modality, view_names
from tdgbench.scenes.scene import PointCloud, Tracks

FORMATS = {".bin": binary, ".txt": text}  # in pycolmap's order of preference
NEEDED = ("cameras", "images", "points3D")
UNIT_TOLERANCE = 1e-3  # of a quaternion's norm; COLMAP writes 1 to the last digits


@dataclass(frozen=True)
class RegisteredImage:
    """One registered image of a COLMAP model."""

    name: str  # of the view
    camera: Camera
    undistortion: Undistortion | None
    key: str  # name in the model, as `names.key` has it

    @property
    def source_size(self) -> tuple[int, int]:
        """Width and height of the camera as in the model, px."""
        return (self.camera.width, self.camera.height) if self.undistortion is None else self.undistortion.source_size

    @property
    def lens(self) -> CameraEntry:
        """The camera as in the model; its id is 1."""
        K, source = self.camera.K, None if self.undistortion is None else self.undistortion.source
        if source is None:
            params = float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])
            return CameraEntry(1, "PINHOLE", self.camera.width, self.camera.height, params)
        return CameraEntry(1, source.model_name, source.width, source.height, tuple(source.params.tolist()))


class ReadModel(NamedTuple):
    """A model as scenes use it."""

    images: dict[str, RegisteredImage]  # by view name
    points: PointCloud | None
    others: dict[str, RegisteredImage]  # of another modality, by view name


def model_files(folder: Path) -> list[Path]:
    """Return the files of a model that are read: cameras, images, points. Raises SceneError where one is missing."""
    lacking = {s: [name + s for name in NEEDED if not is_there(folder / (name + s))] for s in FORMATS}
    suffix = min(FORMATS, key=lambda s: len(lacking[s]))
    if lacking[suffix]:
        raise SceneError(f"{folder} is not a COLMAP model: it has no {', '.join(lacking[suffix])}; {REMEDY}")
    return [folder / (name + suffix) for name in NEEDED]


def read_images(folder: Path) -> list[ImageEntry]:
    """Read the rows of a model's images file. Raises SceneError."""
    _, path, _ = model_files(folder)
    return FORMATS[path.suffix].read_images(path)


def read_model(
    folder: Path, modality: tuple[str, str] | None = None, images: list[ImageEntry] | None = None
) -> ReadModel:
    """Read and check a model, binary or text. Raises SceneError naming the file and the remedy.

    modality: folder of the wanted images and of others in the model's names, where one model has both. images: its
    rows, if they have been read.
    """
    cameras_file, images_file, points_file = model_files(folder)
    reader = FORMATS[cameras_file.suffix]
    rows = reader.read_cameras(cameras_file)
    cameras = {row.id: to_pinhole(row, f"{cameras_file}: camera {row.id}") for row in rows}
    if len(cameras) < len(rows):
        raise DamagedModelError(cameras_file, "two of its cameras have one id")
    images = reader.read_images(images_file) if images is None else images
    if not images:
        raise SceneError(f"{images_file} has no registered image; {REMEDY}")
    if len({image.id for image in images}) < len(images):
        raise DamagedModelError(images_file, "two of its images have one id")
    keys = [key(image.name) for image in images]
    wanted = {*(keys if modality is None else of_modality(keys, *modality))}
    names: dict[str, str] = {}
    for is_wanted in (True, False):
        names |= view_names([one for one in keys if (one in wanted) == is_wanted], str(images_file))
    posed: dict[str, RegisteredImage] = {}
    others: dict[str, RegisteredImage] = {}
    for image, one in zip(images, keys, strict=True):
        if image.camera_id not in cameras:
            what = f"image {image.name!r} has camera {image.camera_id}, which {cameras_file.name} does not hold"
            raise DamagedModelError(images_file, what)
        pinhole, undistortion = cameras[image.camera_id]
        camera = Camera(pinhole.K, _pose(image, images_file), pinhole.width, pinhole.height)
        check_camera(camera, f"{images_file}: image {image.name!r}")
        part = posed if one in wanted else others
        part[names[one]] = RegisteredImage(names[one], camera, undistortion, one)
    views = {image.id: names[one] for image, one in zip(images, keys, strict=True) if one in wanted}
    return ReadModel(posed, _cloud(reader.read_points(points_file), views, points_file), others)


def _pose(image: ImageEntry, path: Path) -> np.ndarray:
    """Return world to camera (4, 4). Raises DamagedModelError for what is no pose."""
    norm = math.hypot(*image.quaternion)
    if not np.isfinite([norm, *image.translation]).all():
        raise DamagedModelError(path, f"the pose of image {image.name!r} is not finite")
    if abs(norm - 1) > UNIT_TOLERANCE:
        raise DamagedModelError(path, f"the quaternion of image {image.name!r} has length {norm:.6g}; it must be 1")
    return np.vstack([image.pose, [0, 0, 0, 1]])


def _cloud(points: Points, names: dict[int, str], path: Path) -> PointCloud | None:
    """Return points in the order of their ids, or None if there are none. names: of views, by image id.

    Raises DamagedModelError.
    """
    if not len(points.ids):
        return None
    order = np.argsort(points.ids)
    ids, xyz = points.ids[order], points.xyz[order]
    twice = ids[1:][ids[1:] == ids[:-1]]
    if len(twice):
        raise DamagedModelError(path, f"it holds point {twice[0]} twice")
    bad = ~(np.abs(xyz) <= MAX_COORDINATE).all(axis=1)  # NaN included
    if bad.any():
        named = ", ".join(map(str, ids[bad][:5]))
        what = f"{int(bad.sum())} points are not finite or beyond {MAX_COORDINATE:g} (point {named})"
        raise DamagedModelError(path, what)
    tracks = None
    if len(points.images):
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        tracks = Tracks(np.repeat(place, points.lengths), points.images, names)
    return PointCloud(xyz, points.colors[order].astype(np.float32) / np.float32(255), tracks, ids)


def write_model(folder: Path, views: list[tuple[str, Camera]], points: PointCloud, observations: int = 0) -> None:
    """Write a binary COLMAP model of views (file name, camera) and points. Views with one K and size share a camera.

    observations: most 2D points of a view. They are projections of points in its image; a surface may hide some.
    """
    model = pycolmap.Reconstruction()
    cameras: dict[tuple[float, ...], int] = {}
    tracks: list[list[pycolmap.TrackElement]] = [[] for _ in points.points]
    for index, (name, camera) in enumerate(views, start=1):
        K, width, height = camera.K, camera.width, camera.height
        intrinsics = (width, height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
        if intrinsics not in cameras:
            number = cameras[intrinsics] = len(cameras) + 1
            shared = pycolmap.Camera(
                model="PINHOLE", width=width, height=height, params=list(intrinsics[2:]), camera_id=number
            )
            model.add_camera_with_trivial_rig(shared)
        rotation = pycolmap.Rotation3d(camera.world_to_camera[:3, :3])
        pose = pycolmap.Rigid3d(rotation, camera.world_to_camera[:3, 3])
        seen = np.flatnonzero(camera.shows(points.points)) if observations else np.empty(0, int)
        seen = seen[:: max(1, -(-len(seen) // max(1, observations)))]
        pixels, _ = camera.project(points.points[seen])
        image = pycolmap.Image(name=name, keypoints=pixels, camera_id=cameras[intrinsics], image_id=index)
        model.add_image_with_trivial_frame(image, pose)
        for place, point in enumerate(seen):
            tracks[point].append(pycolmap.TrackElement(index, place))
    colors = np.round(points.colors * 255).astype(np.uint8)
    for xyz, track, color in zip(points.points, tracks, colors, strict=True):
        model.add_point3D(xyz, pycolmap.Track(track), color)
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder))

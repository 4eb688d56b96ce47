"""Read a COLMAP model, binary or text: registered images with checked pinhole cameras, sparse points; and write one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
import pycolmap

from tdgbench.scenes.colmap import binary, text
from tdgbench.scenes.colmap.agreement import check_agreement
from tdgbench.scenes.colmap.pinhole import Undistortion, to_pinhole
from tdgbench.scenes.colmap.references import camera_poses, check_points
from tdgbench.scenes.colmap.tables import REMEDY, DamagedModelError, ModelTables, Points, by_id
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import check_view_name, is_there
from tdgbench.scenes.scene import Camera, PointCloud
from tdgbench.scenes.validate import check_camera

FORMATS = {".bin": binary, ".txt": text}  # in pycolmap's order of preference
NEEDED = ("cameras", "images", "points3D")


@dataclass(frozen=True)
class RegisteredImage:
    """One registered image of a COLMAP model."""

    name: str  # file name without folder and extension
    camera: Camera
    undistortion: Undistortion | None

    @property
    def source_size(self) -> tuple[int, int]:
        """Width and height of the camera as in the model, px."""
        return (self.camera.width, self.camera.height) if self.undistortion is None else self.undistortion.source_size


class ReadModel(NamedTuple):
    """A model as scenes use it."""

    images: dict[str, RegisteredImage]  # by view name
    points: PointCloud | None
    notes: list[str]  # what is doubtful about it


def read_model(folder: Path) -> ReadModel:
    """Read and check a model, binary or text. Raises SceneError naming the file and the remedy."""
    tables = read_tables(folder)
    if not tables.images:
        raise SceneError(f"{tables.file('images')} has no registered image; {REMEDY}")
    poses = camera_poses(tables)
    check_points(tables)
    cameras = {
        key: to_pinhole(entry, f"{tables.file('cameras')}: camera {entry.id}") for key, entry in tables.cameras.items()
    }
    posed: dict[str, RegisteredImage] = {}
    for image_id, image in tables.images.items():
        where = f"{tables.file('images')}: image {image.name!r}"
        name = check_view_name(PurePosixPath(image.name.replace("\\", "/")).stem, where)
        if name in posed:
            raise SceneError(f"{folder} has two images named {name}; view names must be unique in a scene")
        pinhole, _, undistortion = cameras[image.camera_id]
        pose = np.eye(4)
        pose[:3] = poses[image_id]
        camera = Camera(pinhole.K, pose, pinhole.width, pinhole.height)
        check_camera(camera, where)
        posed[name] = RegisteredImage(name, camera, undistortion)
    sources: dict[int, pycolmap.Camera] = {key: source for key, (_, source, _) in cameras.items()}
    return ReadModel(posed, _cloud(tables.points), check_agreement(tables, poses, sources))


def _cloud(points: Points) -> PointCloud | None:
    """Return points in the order of their ids, or None if there are none."""
    if not len(points.ids):
        return None
    order = np.argsort(points.ids)
    return PointCloud(points.xyz[order], points.colors[order].astype(np.float32) / np.float32(255))


def read_tables(folder: Path) -> ModelTables:
    """Read a model's files. Raises SceneError naming the file and the remedy."""
    suffix = next((s for s in FORMATS if all(is_there(folder / (name + s)) for name in NEEDED)), None)
    if suffix is None:
        raise SceneError(f"{folder} is not a COLMAP model: {_missing(folder)}; {REMEDY}")
    reader = FORMATS[suffix]
    cameras, images, points, rigs, frames = (
        folder / (name + suffix) for name in ("cameras", "images", "points3D", "rigs", "frames")
    )
    if is_there(rigs) != is_there(frames):
        there, absent = (rigs, frames) if is_there(rigs) else (frames, rigs)
        raise DamagedModelError(there, f"{absent.name} is missing beside it")
    return ModelTables(
        folder,
        suffix,
        by_id(cameras, reader.read_cameras(cameras), "camera"),
        by_id(images, reader.read_images(images), "image"),
        reader.read_points(points),
        by_id(rigs, reader.read_rigs(rigs), "rig") if is_there(rigs) else {},
        by_id(frames, reader.read_frames(frames), "frame") if is_there(frames) else {},
    )


def _missing(folder: Path) -> str:
    """Return which files the most complete format lacks."""
    lacking = {s: [name + s for name in NEEDED if not is_there(folder / (name + s))] for s in FORMATS}
    names = min(lacking.values(), key=len)
    return f"it has no {', '.join(names)}"


def write_model(folder: Path, views: list[tuple[str, Camera]], points: PointCloud, observations: int = 0) -> None:
    """Write a binary COLMAP model of views (file name, camera) and points. Views with one K and size share a camera.

    observations: so many of the points that lie in a view's image, at most, are its 2D points, where they are projected
    to; points that a surface hides are among them.
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

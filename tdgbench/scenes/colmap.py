"""COLMAP models through pycolmap: cameras, poses, sparse points; distorted cameras become pinholes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
import pycolmap
from scipy.ndimage import map_coordinates

from tdgbench.scenes.scene import Camera, PointCloud, SceneError


@dataclass(frozen=True)
class Undistortion:
    """Position of each pinhole pixel in the distorted image."""

    rows: np.ndarray  # (H, W) float64, pixel indices
    columns: np.ndarray  # (H, W) float64, pixel indices
    source_size: tuple[int, int]  # width, height of the distorted image, px

    def apply(self, image: np.ndarray) -> np.ndarray:
        """Resample an image (H, W, C) bilinearly to (H', W', C) of the pinhole; the border is replicated."""
        height, width = image.shape[:2]
        rows = (self.rows + 0.5) * height / self.source_size[1] - 0.5
        columns = (self.columns + 0.5) * width / self.source_size[0] - 0.5
        planes = [
            map_coordinates(image[..., c], [rows, columns], order=1, mode="nearest") for c in range(image.shape[2])
        ]
        return np.stack(planes, axis=-1)


@dataclass(frozen=True)
class RegisteredImage:
    """One registered image of a COLMAP model."""

    name: str  # file name without folder and extension
    camera: Camera
    undistortion: Undistortion | None


def read_model(folder: Path) -> tuple[dict[str, RegisteredImage], PointCloud | None]:
    """Registered images by name, and sparse points or None. Raises SceneError."""
    try:
        model = pycolmap.Reconstruction(str(folder))
    except Exception as error:
        raise SceneError(f"{folder} is not a COLMAP model: {error}") from error
    pinholes = {camera_id: _pinhole(camera, folder) for camera_id, camera in model.cameras.items()}
    posed: dict[str, RegisteredImage] = {}
    for image in model.images.values():
        if not image.has_pose:
            continue
        name = PurePosixPath(image.name.replace("\\", "/")).stem
        if name in posed:
            raise SceneError(f"{folder} has two images named {name}; view names must be unique in a scene")
        pinhole, undistortion = pinholes[image.camera_id]
        pose = np.eye(4)
        pose[:3] = image.cam_from_world().matrix()
        camera = Camera(np.array(pinhole.calibration_matrix()), pose, pinhole.width, pinhole.height)
        posed[name] = RegisteredImage(name, camera, undistortion)
    if not posed:
        raise SceneError(f"{folder} has no registered image")
    points = None
    if len(model.points3D):
        values = [model.points3D[i] for i in sorted(model.points3D)]
        points = PointCloud(
            np.array([p.xyz for p in values], np.float64),
            np.array([p.color for p in values], np.float32) / np.float32(255),
        )
    return posed, points


def write_model(folder: Path, views: list[tuple[str, Camera]], points: PointCloud) -> None:
    """Write a binary COLMAP model of views (file name, camera), which share one K, and points."""
    model = pycolmap.Reconstruction()
    for index, (name, camera) in enumerate(views, start=1):
        K = camera.K
        if index == 1:
            first = pycolmap.Camera(
                model="PINHOLE",
                width=camera.width,
                height=camera.height,
                params=[K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
                camera_id=1,
            )
            model.add_camera_with_trivial_rig(first)
        elif not np.array_equal(K, views[0][1].K):
            raise ValueError("all views of a written model share one camera")
        rotation = pycolmap.Rotation3d(camera.world_to_camera[:3, :3])
        pose = pycolmap.Rigid3d(rotation, camera.world_to_camera[:3, 3])
        model.add_image_with_trivial_frame(pycolmap.Image(name=name, camera_id=1, image_id=index), pose)
    colors = np.round(points.colors * 255).astype(np.uint8)
    for xyz, color in zip(points.points, colors, strict=True):
        model.add_point3D(xyz, pycolmap.Track(), color)
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder))


def _pinhole(camera: pycolmap.Camera, folder: Path) -> tuple[pycolmap.Camera, Undistortion | None]:
    """The camera itself if it is a pinhole; else pycolmap's undistorted pinhole, and how to resample images to it."""
    if camera.model.name in ("PINHOLE", "SIMPLE_PINHOLE"):
        return camera, None
    try:
        pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), camera)
    except Exception as error:
        raise SceneError(f"{folder}: camera {camera.camera_id} cannot be undistorted: {error}") from error
    x, y = np.meshgrid(np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
    rays = pinhole.cam_from_img(np.stack([x.ravel(), y.ravel()], axis=-1))
    pixels = camera.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1))
    columns, rows = (pixels - 0.5).T.reshape(2, pinhole.height, pinhole.width)
    return pinhole, Undistortion(rows, columns, (camera.width, camera.height))

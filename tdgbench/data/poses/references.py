"""Read poses of a scene, a COLMAP model, or a file of nerfstudio, OpenSfM or Metashape."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tdgbench.data.poses.metashape import chunk_poses, read_xml, table_poses
from tdgbench.scenes.colmap import RegisteredImage, read_model
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.images import SUFFIXES
from tdgbench.scenes.inputs import is_folder, read_json, regular_file
from tdgbench.scenes.layouts import detect
from tdgbench.scenes.layouts.transforms import read_transforms
from tdgbench.scenes.validate import check_pose

READ = "a scene, a COLMAP model, transforms.json, reconstruction.json, or Metashape's .xml, chunk.zip, .txt"


class Pose(NamedTuple):
    """A view's pose in OpenCV axes, and what is known of its lens."""

    world_to_camera: np.ndarray  # (4, 4)
    focal: float | None = None  # px
    width: int | None = None  # px, of the image


def read_poses(path: Path) -> dict[str, Pose]:
    """Return poses by view name: that of the image without folder and extension. Raises SceneError naming the file."""
    if is_folder(path):
        layout = detect(path)
        found = None if layout is None else layout.find(path)
        images = read_model(path).images if found is None else found.posed
        poses = _of_images(one for one in images.values() if found is None or one.name in found.thermal)
    elif path.suffix.lower() == ".json":
        poses = _read_json(path)
    elif path.suffix.lower() == ".txt":
        poses = {name: Pose(pose) for name, pose in table_poses(path).items()}
    elif path.suffix.lower() in (".xml", ".zip"):
        poses = {name: Pose(*pose) for name, pose in chunk_poses(read_xml(path), path).items()}
    else:
        raise SceneError(f"{regular_file(path)} holds no poses that are read here; give {READ}")
    if not poses:
        raise SceneError(f"{path} has no registered view; align the images first, and export again")
    named: dict[str, Pose] = {}
    for name, pose in poses.items():
        file = PurePosixPath(name.replace("\\", "/"))
        view = file.stem if file.suffix.lower() in SUFFIXES else file.name
        if view in named:
            raise SceneError(f"{path} has two views named {view}; keep one of them")
        check_pose(pose.world_to_camera, f"{path}: view {view}")
        named[view] = pose
    return named


def _of_images(images: Iterable[RegisteredImage]) -> dict[str, Pose]:
    """Return poses of a model's images, whose distorted cameras have become pinholes of the same focal length."""
    cameras = {image.name: image.camera for image in images}
    return {name: Pose(one.world_to_camera, float(one.K[0, 0]), one.width) for name, one in cameras.items()}


def _read_json(path: Path) -> dict[str, Pose]:
    """Read a transforms.json, or the largest model of OpenSfM's reconstruction.json.

    OpenSfM (docs: "Dataset structure", "Camera models"): rotation is an angle-axis vector; with the translation, it
    leads from the world to the camera in OpenCV's axes. Focal lengths are shares of the longer side.
    """
    try:
        content = read_json(path)
        if isinstance(content, dict):
            return _of_images(frame.posed for frame in read_transforms(path).frames.values())
        model = max(content, key=lambda one: len(one["shots"]))
        poses = {}
        for name, shot in model["shots"].items():
            lens, pose = model["cameras"][shot["camera"]], np.eye(4)
            pose[:3, :3] = Rotation.from_rotvec(shot["rotation"]).as_matrix()
            pose[:3, 3] = shot["translation"]
            share = float(lens["focal_x"] if "focal_x" in lens else lens["focal"])
            poses[name] = Pose(pose, share * max(lens["width"], lens["height"]), lens["width"])
        return poses
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        raise SceneError(
            f"{path} is no reconstruction.json of OpenSfM or transforms.json: {error!r}; export it again"
        ) from error

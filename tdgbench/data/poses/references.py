"""Read poses of a scene, a COLMAP model, or a file of nerfstudio, OpenSfM or Metashape, with lenses and points."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tdgbench.data.poses import Reference
from tdgbench.data.poses.metashape import read_metashape, table_poses
from tdgbench.scenes import PointCloud
from tdgbench.scenes.camera import check_pose
from tdgbench.scenes.colmap import RegisteredImage, read_model
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import decoding, is_folder, is_there, read_json, regular_file
from tdgbench.scenes.layouts import detect
from tdgbench.scenes.layouts.transforms import read_points, read_transforms, where_they_are
from tdgbench.scenes.names import key, view_names

FRAMES = "perspective", "simple_radial", "radial", "brown"  # OpenSfM's cameras that OpenCV's model can say
READ = "a scene, a COLMAP model, transforms.json, reconstruction.json, or Metashape's .xml, chunk.zip, .txt"


def read_reference(path: Path) -> Reference:
    """Read poses by view name (`names.view_names`). Raises SceneError naming the file."""
    suffix = path.suffix.lower()
    if is_folder(path):
        reference = _read_folder(path)
    elif suffix in READERS:
        reference = READERS[suffix](path)
    else:
        raise SceneError(f"{regular_file(path)} holds no poses that are read here; give {READ}")
    if not reference.poses:
        raise SceneError(f"{path} has no registered view; align the images first, and export again")
    views = view_names([key(name) for name in reference.poses], str(path))
    poses = {views[key(name)]: pose for name, pose in reference.poses.items()}
    for view, pose in poses.items():
        check_pose(pose, f"{path}: view {view}")
    return reference._replace(poses=poses, lens_ids={views[key(name)]: one for name, one in reference.lens_ids.items()})


def _read_folder(path: Path) -> Reference:
    """Read a scene, whose posed thermal images count, or a COLMAP model."""
    layout = detect(path)
    if layout is None:
        model = read_model(path)
        return _of_images([*model.images.values()], model.points)
    found = layout.find(path)
    return _of_images([image for image in found.posed.values() if image.name in found.thermal], found.points)


def _of_images(images: list[RegisteredImage], points: PointCloud | None) -> Reference:
    poses = {image.name: image.camera.world_to_camera for image in images}
    return Reference(poses, lambda: list(dict.fromkeys(image.lens for image in images)), points)


def _read_json(path: Path) -> Reference:
    """Read a transforms.json with the points that it names, or the largest model of OpenSfM's reconstruction.json."""
    with decoding(path, "a reconstruction.json of OpenSfM, or a transforms.json", "export it again"):
        content = read_json(path)
        if isinstance(content, dict):
            return _of_transforms(path)
        return _of_opensfm(max(content, key=lambda one: len(one["shots"])))


def _of_transforms(path: Path) -> Reference:
    content = read_transforms(path)
    images = list(content.posed.values())
    ply = None if content.points is None else path.parent / content.points
    if ply is None or not is_there(ply):
        return _of_images(images, None)
    points, _ = where_they_are(read_points(ply)[0], content.applied_transform, [image.camera for image in images])
    return _of_images(images, points)


def _of_opensfm(model: Mapping[str, Any]) -> Reference:
    """Read a model (mapillary/OpenSfM 054a1d8, doc/source/geometry.rst).

    A rotation is an angle-axis vector; with the translation, it leads from the world to OpenCV's axes.
    """
    poses = {}
    for name, shot in model["shots"].items():
        pose = poses[name] = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(shot["rotation"]).as_matrix()
        pose[:3, 3] = shot["translation"]
    points = list(model.get("points", {}).values())
    if not points:
        return Reference(poses, lambda: _opensfm_lenses(model))
    xyz = np.array([point["coordinates"] for point in points], np.float64)
    if not np.isfinite(xyz).all():
        raise ValueError("a point is not finite")
    colors = np.array([point["color"] for point in points], np.float32) / np.float32(255)
    return Reference(poses, lambda: _opensfm_lenses(model), PointCloud(xyz, colors))


def _opensfm_lenses(model: Mapping[str, Any]) -> list[CameraEntry]:
    """Return the cameras as COLMAP's FULL_OPENCV; OpenSfM's lengths are shares of the longer side, from the centre.

    Raises SceneError for what that model cannot say.
    """
    found = []
    for name in sorted({shot["camera"] for shot in model["shots"].values()}):
        try:
            lens = model["cameras"][name]
            if lens["projection_type"] not in FRAMES:
                raise ValueError(f"it is none of {', '.join(FRAMES)}")
            width, height = lens["width"], lens["height"]
            unit = max(width, height)
            f = [float(lens[key] if key in lens else lens["focal"]) * unit for key in ("focal_x", "focal_y")]
            centre = width / 2 + lens.get("c_x", 0.0) * unit, height / 2 + lens.get("c_y", 0.0) * unit
            distortion = (float(lens.get(key, 0.0)) for key in ("k1", "k2", "p1", "p2", "k3"))
            found.append(CameraEntry(1, "FULL_OPENCV", width, height, (*f, *centre, *distortion, 0.0, 0.0, 0.0)))
        except (KeyError, TypeError, ValueError) as error:
            raise SceneError(f"OpenSfM's camera {name!r} cannot be read: {error!r}; export it again") from error
    return found


READERS: dict[str, Callable[[Path], Reference]] = {  # of files, by suffix
    ".json": _read_json,
    ".txt": lambda path: Reference(table_poses(path)),
    ".xml": read_metashape,
    ".zip": read_metashape,
}

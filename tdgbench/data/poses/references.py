"""Read poses of a scene, a COLMAP model, or a file of nerfstudio, OpenSfM or Metashape, with lenses and points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from tdgbench.data.poses.metashape import lenses, read_chunk, read_xml, table_poses
from tdgbench.data.poses.opensfm import model_points, shot_lenses, shot_poses
from tdgbench.scenes import PointCloud
from tdgbench.scenes.camera import check_pose
from tdgbench.scenes.colmap import RegisteredImage, read_model
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import decoding, is_folder, is_there, read_json, regular_file
from tdgbench.scenes.layouts import detect
from tdgbench.scenes.layouts.transforms import read_points, read_transforms, where_they_are
from tdgbench.scenes.names import key, view_names

READ = "a scene, a COLMAP model, transforms.json, reconstruction.json, or Metashape's .xml, chunk.zip, .txt"


class Reference(NamedTuple):
    """What another program found. poses: world to camera (4, 4) in OpenCV axes, by view name.

    lenses: none if they are not stated; raises SceneError for one that COLMAP cannot say.
    """

    poses: dict[str, np.ndarray]
    lenses: Callable[..., list[CameraEntry]] = list  # all, or those of given ids
    points: PointCloud | None = None
    lens_ids: Mapping[str, int] = MappingProxyType({})  # of each view's lens, where the file says it
    notes: Sequence[str] = ()  # on what the file holds beside


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


def _read_metashape(path: Path) -> Reference:
    root = read_xml(path)
    chunk = read_chunk(root, path)
    return Reference(chunk.poses, lambda *ids: lenses(root, path, *ids), None, chunk.lenses, chunk.notes)


def _of_images(images: list[RegisteredImage], points: PointCloud | None) -> Reference:
    poses = {image.name: image.camera.world_to_camera for image in images}
    return Reference(poses, lambda: list(dict.fromkeys(image.lens for image in images)), points)


def _read_json(path: Path) -> Reference:
    """Read a transforms.json with the points that it names, or the largest model of OpenSfM's reconstruction.json."""
    with decoding(path, "a reconstruction.json of OpenSfM, or a transforms.json", "export it again"):
        content = read_json(path)
        if isinstance(content, dict):
            return _of_transforms(path)
        model = max(content, key=lambda one: len(one["shots"]))
        return Reference(shot_poses(model), lambda: shot_lenses(model), model_points(model))


def _of_transforms(path: Path) -> Reference:
    content = read_transforms(path)
    images = [frame.posed for frame in content.frames.values()]
    ply = None if content.points is None else path.parent / content.points
    if ply is None or not is_there(ply):
        return _of_images(images, None)
    points, _ = where_they_are(read_points(ply)[0], content.applied_transform, [image.camera for image in images])
    return _of_images(images, points)


READERS: dict[str, Callable[[Path], Reference]] = {  # of files, by suffix
    ".json": _read_json,
    ".txt": lambda path: Reference(table_poses(path)),
    ".xml": _read_metashape,
    ".zip": _read_metashape,
}

"""Check what the rows of a COLMAP model say about each other, and find the pose of each image.

pycolmap checks the same references, but says neither the file nor the remedy; and it ignores the poses of images.bin
where frames.bin has others.
"""

from __future__ import annotations

import math

import numpy as np
import pycolmap

from tdgbench.scenes.colmap.tables import NO_POINT, DamagedModelError, ModelTables, PoseEntry, Sensor
from tdgbench.scenes.validate import MAX_COORDINATE

UNIT_TOLERANCE = 1e-3  # of a quaternion's norm; COLMAP writes 1 to the last digits
ROUNDING = 1e-12  # of that norm
POSE_TOLERANCE = 1e-6  # between images and frames; of the translation, as a share of its length where that is above 1


def check_points(model: ModelTables) -> None:
    """Raise DamagedModelError for a point twice or not finite, or a track of what the images do not hold."""
    points, path = model.points, model.file("points3D")
    ids, counts = np.unique(points.ids, return_counts=True)
    if len(ids) < len(points.ids):
        raise DamagedModelError(path, f"it holds point {ids[counts > 1][0]} twice")
    bad = ~(np.abs(points.xyz) <= MAX_COORDINATE).all(axis=1)  # NaN included
    if bad.any():
        named = ", ".join(map(str, points.ids[bad][:5]))
        raise DamagedModelError(
            path, f"{int(bad.sum())} points are not finite or beyond {MAX_COORDINATE:g} (point {named})"
        )
    for image in model.images.values():
        if len(image.compared) and not len(points.ids):
            raise DamagedModelError(path, f"it holds no point, but image {image.name!r} shows some")
        if not np.isfinite(image.pixels).all():
            raise DamagedModelError(model.file("images"), f"2-D points of image {image.name!r} are not finite")
    if len(points.track_images):
        _check_tracks(model)


def _check_tracks(model: ModelTables) -> None:
    images = sorted(model.images)
    rows = np.searchsorted(images, points_images := model.points.track_images.astype(np.int64))
    rows = np.minimum(rows, len(images) - 1)
    sizes = np.array([len(model.images[i].point_ids) for i in images])
    firsts = np.cumsum(sizes) - sizes
    of_points = np.repeat(model.points.ids, model.points.track_lengths)
    known = np.array(images)[rows] == points_images
    inside = known & (model.points.track_points2D < sizes[rows])
    places = np.where(inside, firsts[rows] + model.points.track_points2D, 0)
    named = np.concatenate([*(model.images[i].point_ids for i in images), [np.uint64(NO_POINT)]])[places]
    agrees = inside & ((named == of_points) | (named == NO_POINT))
    if not agrees.all():
        at = int(np.argmin(agrees))
        image, point2D = int(points_images[at]), int(model.points.track_points2D[at])
        what = f"the track of point {of_points[at]} names "
        if not known[at]:
            what += f"image {image}, which {model.file('images').name} does not hold"
        elif not inside[at]:
            what += f"2-D point {point2D} of image {image}, which has {sizes[rows[at]]}"
        else:
            what += f"2-D point {point2D} of image {image}, which belongs to point {named[at]}"
        raise DamagedModelError(model.file("points3D"), what)


def camera_poses(model: ModelTables) -> dict[int, np.ndarray]:
    """Return world to camera (3, 4) by image id. Raises DamagedModelError for references to nothing or damage."""
    for image in model.images.values():
        _check_pose(model, "images", f"image {image.name!r}", image.pose)
        if image.camera_id not in model.cameras:
            raise DamagedModelError(
                model.file("images"),
                f"image {image.name!r} has camera {image.camera_id}, which {model.file('cameras').name} does not hold",
            )
    own = {image_id: _rigid(image.pose) for image_id, image in model.images.items()}
    if not model.rigs and not model.frames:  # as COLMAP before 3.12 writes models
        return {image_id: pose.matrix() for image_id, pose in own.items()}
    poses = {}
    placed = _frame_of_images(model)
    for image_id, image in model.images.items():
        if image_id not in placed:
            raise DamagedModelError(model.file("frames"), f"no frame holds image {image_id}, {image.name!r}")
        poses[image_id] = _pose_in_frame(model, image_id, *placed[image_id]).matrix()
        if not _close(poses[image_id], own[image_id].matrix()):
            raise DamagedModelError(
                model.file("frames"),
                f"the pose of image {image.name!r} differs from that in {model.file('images').name}",
                f"copy or download the model again; if {model.file('images').name} was edited, delete "
                f"{model.file('rigs').name} and {model.file('frames').name}",
            )
    return poses


def _frame_of_images(model: ModelTables) -> dict[int, tuple[int, Sensor]]:
    """Return the frame and sensor of each image that frames name."""
    for rig in model.rigs.values():
        for sensor, pose in rig.sensors.items():
            if sensor.type == "CAMERA" and sensor.id not in model.cameras:
                raise DamagedModelError(
                    model.file("rigs"),
                    f"rig {rig.id} has camera {sensor.id}, which {model.file('cameras').name} does not hold",
                )
            if pose is not None:
                _check_pose(model, "rigs", f"{sensor.type} {sensor.id} of rig {rig.id}", pose)
    placed: dict[int, tuple[int, Sensor]] = {}
    for frame in model.frames.values():
        _check_pose(model, "frames", f"frame {frame.id}", frame.pose)
        if frame.rig_id not in model.rigs:
            raise DamagedModelError(
                model.file("frames"), f"frame {frame.id} has rig {frame.rig_id}, which {model.file('rigs')} lacks"
            )
        for sensor, data_id in frame.data:
            if sensor.type != "CAMERA":
                continue
            if sensor not in model.rigs[frame.rig_id].sensors:
                raise DamagedModelError(
                    model.file("frames"), f"frame {frame.id} has camera {sensor.id}, which its rig lacks"
                )
            if data_id in placed:
                raise DamagedModelError(model.file("frames"), f"image {data_id} is in two frames")
            placed[data_id] = frame.id, sensor
    return placed


def _pose_in_frame(model: ModelTables, image_id: int, frame_id: int, sensor: Sensor) -> pycolmap.Rigid3d:
    """Return the pose of an image: that of its frame, and of its sensor in the rig unless that is the reference."""
    image, frame = model.images[image_id], model.frames[frame_id]
    if sensor.id != image.camera_id:
        raise DamagedModelError(
            model.file("frames"),
            f"image {image.name!r} has camera {sensor.id}, but in {model.file('images').name} {image.camera_id}",
        )
    sensors = model.rigs[frame.rig_id].sensors
    if sensor == next(iter(sensors)):
        return _rigid(frame.pose)
    in_rig = sensors[sensor]
    if in_rig is None:
        raise DamagedModelError(model.file("rigs"), f"camera {sensor.id} of rig {frame.rig_id} has no pose")
    return _rigid(in_rig) * _rigid(frame.pose)


def _check_pose(model: ModelTables, file: str, what: str, pose: PoseEntry) -> None:
    norm = math.hypot(*pose.quaternion)
    if not np.isfinite([norm, *pose.translation]).all():
        raise DamagedModelError(model.file(file), f"the pose of {what} is not finite")
    if abs(norm - 1) > UNIT_TOLERANCE:
        raise DamagedModelError(model.file(file), f"the quaternion of {what} has length {norm:.6g}; it must be 1")


def _rigid(pose: PoseEntry) -> pycolmap.Rigid3d:
    """Return a pose whose rotation is one: pycolmap takes a quaternion of another length as it is."""
    w, x, y, z = pose.quaternion
    quaternion, norm = np.array([x, y, z, w]), math.hypot(*pose.quaternion)
    if abs(norm - 1) > ROUNDING:
        quaternion /= norm
    return pycolmap.Rigid3d(pycolmap.Rotation3d(quaternion), np.array(pose.translation))


def _close(a: np.ndarray, b: np.ndarray) -> bool:
    scale = max(1.0, float(np.abs(b[:, 3]).max()))
    return bool(
        np.abs(a[:, :3] - b[:, :3]).max() <= POSE_TOLERANCE
        and np.abs(a[:, 3] - b[:, 3]).max() <= POSE_TOLERANCE * scale
    )

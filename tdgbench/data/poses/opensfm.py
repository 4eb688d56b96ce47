"""OpenSfM's reconstruction.json: poses, lenses and points of its largest model.

Facts: mapillary/OpenSfM 054a1d8, doc/source/geometry.rst. A rotation is an angle-axis vector; with the translation, it
leads from the world to the camera in OpenCV's axes. Lengths in images are shares of the longer side, from the centre.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tdgbench.scenes import PointCloud, SceneError
from tdgbench.scenes.colmap.tables import CameraEntry

FRAMES = "perspective", "simple_radial", "radial", "brown"  # cameras that OpenCV's model can say
COEFFICIENTS = "k1", "k2", "p1", "p2", "k3"


def shot_poses(model: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return world to camera (4, 4) by image."""
    poses = {}
    for name, shot in model["shots"].items():
        pose = poses[name] = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(shot["rotation"]).as_matrix()
        pose[:3, 3] = shot["translation"]
    return poses


def shot_lenses(model: Mapping[str, Any]) -> list[CameraEntry]:
    """Return the cameras as COLMAP's FULL_OPENCV. Raises SceneError for what that model cannot say."""
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
            distortion = (float(lens.get(key, 0.0)) for key in COEFFICIENTS)
            found.append(CameraEntry(1, "FULL_OPENCV", width, height, (*f, *centre, *distortion, 0.0, 0.0, 0.0)))
        except (KeyError, TypeError, ValueError) as error:
            raise SceneError(f"OpenSfM's camera {name!r} cannot be read: {error!r}; export it again") from error
    return found


def model_points(model: Mapping[str, Any]) -> PointCloud | None:
    """Return the points, or None if there are none."""
    points = list(model.get("points", {}).values())
    if not points:
        return None
    xyz = np.array([point["coordinates"] for point in points], np.float64)
    if not np.isfinite(xyz).all():
        raise ValueError("a point is not finite")
    colors = np.array([point["color"] for point in points], np.float32) / np.float32(255)
    return PointCloud(xyz, colors)

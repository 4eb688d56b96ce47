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


def shot_poses(model: Mapping[str, Any]) -> dict[str, tuple[np.ndarray, float, int]]:
    """Return world to camera (4, 4), focal length in px and width in px by image."""
    poses = {}
    for name, shot in model["shots"].items():
        lens, pose = model["cameras"][shot["camera"]], np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(shot["rotation"]).as_matrix()
        pose[:3, 3] = shot["translation"]
        poses[name] = pose, _focal(lens, "x"), lens["width"]
    return poses


def shot_lenses(model: Mapping[str, Any]) -> list[CameraEntry]:
    """Return the cameras as COLMAP's FULL_OPENCV. Raises SceneError for what that model cannot say."""
    found = []
    for name in sorted({shot["camera"] for shot in model["shots"].values()}):
        lens = model["cameras"][name]
        kind, width, height = lens.get("projection_type"), lens["width"], lens["height"]
        if kind not in FRAMES:
            raise SceneError(f"OpenSfM's camera {name!r} is {kind}; give one that is {', '.join(FRAMES)}")
        centre = (side / 2 + lens.get(key, 0.0) * max(width, height) for side, key in ((width, "c_x"), (height, "c_y")))
        distortion = (float(lens.get(key, 0.0)) for key in COEFFICIENTS)
        params = _focal(lens, "x"), _focal(lens, "y"), *centre, *distortion, 0.0, 0.0, 0.0
        found.append(CameraEntry(1, "FULL_OPENCV", width, height, params))
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


def _focal(lens: Mapping[str, Any], axis: str) -> float:
    share = lens[f"focal_{axis}"] if f"focal_{axis}" in lens else lens["focal"]
    return float(share) * max(lens["width"], lens["height"])

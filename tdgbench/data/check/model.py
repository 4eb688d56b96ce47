"""Find cameras whose numbers are valid but wrong: their points do not project to where the images show them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap.model import FORMATS, model_files
from tdgbench.scenes.colmap.tables import ImageEntry
from tdgbench.terminal import say

FEWEST = 10  # points of a view from which it is judged
EACH = 2500  # images from one line of progress to the next; with 4 000 points each, some 5 s
FAR = 0.05  # median error of a wrong view, × diagonal of the image; COLMAP drops what is 4 px off, some 0.005


def wrong_views(folder: Path) -> list[str]:
    """Return a problem per view of a COLMAP model whose points project far from where it shows them.

    Models without 2-D points, and ones that are not read, have none. Points may have been removed.
    """
    try:
        cameras_file, images_file, points_file = model_files(folder)
        reader = FORMATS[cameras_file.suffix]
        cameras = {
            row.id: pycolmap.Camera(model=row.model, width=row.width, height=row.height, params=list(row.params))
            for row in reader.read_cameras(cameras_file)
        }
        views = [(row, cameras[row.camera_id]) for row in reader.read_images(images_file, observed=True)]
        points = reader.read_points(points_file)
    except (SceneError, LookupError, ValueError, TypeError):  # the last of pycolmap, for a size that no camera has
        return []
    order, problems = np.argsort(points.ids), []
    ids, xyz = points.ids[order], points.xyz[order]
    for number, (image, camera) in enumerate(views):
        if number and number % EACH == 0:
            say(f"{number:,} of {len(views):,} images", "projected", "dim", stderr=True)
        shown = image.points[np.argsort(image.points["point"])]  # in order, in which they are found 2 × as fast
        place = np.searchsorted(ids, shown["point"])
        known = place < len(ids)
        known[known] = ids[place[known]] == shown["point"][known]
        if known.sum() < FEWEST:
            continue
        errors = _errors(image, camera, shown["xy"][known], xyz[place[known]])
        share = float(np.median(errors)) / float(np.hypot(camera.width, camera.height))
        if share > FAR:
            off = f"project {share:.0%} of the diagonal off" if np.isfinite(share) else "lie behind it"
            problems.append(
                f"{image.name}: the points that it shows {off}; its pose or its camera in {folder} is wrong"
            )
    return problems


def _errors(image: ImageEntry, camera: pycolmap.Camera, xy: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Return how far (N,) px from their places (N, 2) in an image points (N, 3) project; inf for those behind it."""
    w, x, y, z = image.quaternion
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array([x, y, z, w])), np.array(image.translation)).matrix()
    projected = np.asarray(camera.img_from_cam(xyz @ pose[:, :3].T + pose[:, 3]))
    return np.where(np.isfinite(projected).all(axis=1), np.hypot(*(xy - projected).T), np.inf)

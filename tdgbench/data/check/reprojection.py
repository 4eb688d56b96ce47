"""Find cameras whose numbers are valid but wrong: their points do not project to where the images show them."""

from __future__ import annotations

import numpy as np
import pycolmap

from tdgbench.scenes import Scene, SceneError
from tdgbench.scenes.colmap.model import FORMATS, model_files
from tdgbench.scenes.colmap.tables import ImageEntry

FEWEST, MOST = 10, 1000  # points of a view by which it is judged
FAR = 0.05  # median error of a wrong view, × diagonal of the image; COLMAP drops what is 4 px off, some 0.005
NO_POINT = np.uint64(2**64 - 1)  # of a 2-D point, in place of its point's id


def wrong_views(scene: Scene) -> list[str]:
    """Return a problem per view of the scene's COLMAP model whose points project far from where it shows them.

    Models without 2-D points, and ones that are not read, have none. Points may have been removed.
    """
    folder, points = scene.model, scene.points
    if folder is None or points is None or points.ids is None:
        return []
    try:
        cameras_file, images_file, _ = model_files(folder)
        reader = FORMATS[cameras_file.suffix]
        cameras = {
            row.id: pycolmap.Camera(model=row.model, width=row.width, height=row.height, params=list(row.params))
            for row in reader.read_cameras(cameras_file)
        }
        views = [(row, cameras[row.camera_id]) for row in reader.read_images(images_file, observed=True)]
    except (SceneError, LookupError, ValueError, TypeError):  # the last of pycolmap, for a size that no camera has
        return []
    ids, xyz, problems = points.ids, points.points + scene.origin, []
    for image, camera in views:
        shown = image.points[image.points["point"] != NO_POINT]
        place = np.searchsorted(ids, shown["point"])
        known = place < len(ids)
        known[known] = ids[place[known]] == shown["point"][known]
        if known.sum() < FEWEST:
            continue
        sample = np.flatnonzero(known)[:: -(-known.sum() // MOST)]
        errors = _errors(image, camera, shown["xy"][sample], xyz[place[sample]])
        share = float(np.median(errors)) / float(np.hypot(camera.width, camera.height))
        if share > FAR:
            off = f"project {share:.0%} of the diagonal off" if np.isfinite(share) else "lie behind it"
            problems.append(
                f"{image.name}: the points that it shows {off}; its pose or its camera in {folder} is wrong"
            )
    return problems


def _errors(image: ImageEntry, camera: pycolmap.Camera, xy: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Return how far (N,) px from their places (N, 2) in an image points (N, 3) project; inf for those behind it."""
    pose = image.pose
    projected = np.asarray(camera.img_from_cam(xyz @ pose[:, :3].T + pose[:, 3]))
    return np.where(np.isfinite(projected).all(axis=1), np.hypot(*(xy - projected).T), np.inf)

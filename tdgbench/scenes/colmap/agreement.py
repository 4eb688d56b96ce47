"""Find cameras whose numbers are valid but wrong: their points do not project to where the images show them."""

from __future__ import annotations

import numpy as np
import pycolmap

from tdgbench.scenes.colmap.tables import NO_POINT, DamagedModelError, ImageEntry, ModelTables

FEWEST = 10  # observations of a view from which it is judged
FAR = 0.05  # median error of a wrong view, × diagonal of the image
NEAR = 0.02  # median error of a good view stays below; COLMAP drops observations that are 4 px off, some 0.005


def check_agreement(model: ModelTables, poses: dict[int, np.ndarray], cameras: dict[int, pycolmap.Camera]) -> list[str]:
    """Return notes on the model. Raises DamagedModelError for a view that disagrees where the others agree.

    poses: world to camera (3, 4) by image id. cameras: as in the model, with distortion, by camera id.
    """
    points = _all_points(model)
    return [*_missing_points(model, points[0]), *_reprojection(model, points, poses, cameras)]


def _missing_points(model: ModelTables, ids: np.ndarray) -> list[str]:
    """Return a note if images show points that the model does not hold (ids (P,), ascending)."""
    shown = np.concatenate([image.point_ids for image in model.images.values()])
    shown = shown[shown != NO_POINT]
    missing = int((~np.isin(shown, ids)).sum()) if len(ids) else 0
    if not missing:
        return []
    what = f"{missing} of {len(shown)} 2-D points of its images are of points that it does not hold"
    return [f"{model.file('points3D')}: {what}; were points removed, or is the file of another model?"]


def _reprojection(
    model: ModelTables,
    points: tuple[np.ndarray, np.ndarray],
    poses: dict[int, np.ndarray],
    cameras: dict[int, pycolmap.Camera],
) -> list[str]:
    """Return notes on views whose points do not project to where they are shown. Raises DamagedModelError."""
    errors = {}
    for image_id, image in model.images.items():
        pixels, xyz = _observations(image, *points)
        if len(pixels) >= FEWEST:
            errors[image_id] = _median_error(pixels, xyz, poses[image_id], cameras[image.camera_id])
    if not errors:
        return []
    median = float(np.median(list(errors.values())))
    worst = max(errors, key=errors.__getitem__)
    if median >= NEAR:
        return [
            f"the sparse points project {median:.0%} of the image's diagonal from their 2-D points in the median view; "
            f"were {model.file('cameras').name} or the poses edited?"
        ]
    name = model.images[worst].name
    if errors[worst] > FAR:
        off = "lie behind it" if np.isinf(errors[worst]) else f"project {errors[worst]:.0%} of the diagonal off"
        raise DamagedModelError(
            model.file("images"),
            f"the points that image {name!r} shows {off}, but those of the median view {median:.2%}; its pose or "
            f"its camera {model.images[worst].camera_id} is wrong",
            "copy or download the model again, or remove the image from it",
        )
    if errors[worst] > NEAR:
        return [f"the sparse points of {name} project {errors[worst]:.1%} of the image's diagonal from its 2-D points"]
    return []


def _all_points(model: ModelTables) -> tuple[np.ndarray, np.ndarray]:
    """Return ids (P,), ascending, and positions (P, 3)."""
    order = np.argsort(model.points.ids)
    return model.points.ids[order], model.points.xyz[order]


def _observations(image: ImageEntry, ids: np.ndarray, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the compared 2-D points (N, 2) of an image whose 3-D points the model holds, and these (N, 3)."""
    wanted = image.point_ids[image.compared]
    rows = np.minimum(np.searchsorted(ids, wanted), max(len(ids) - 1, 0))
    known = ids[rows] == wanted if len(ids) else np.zeros(len(wanted), bool)
    return image.pixels[known], xyz[rows[known]]


def _median_error(pixels: np.ndarray, xyz: np.ndarray, pose: np.ndarray, camera: pycolmap.Camera) -> float:
    """Return the median distance between projections and 2-D points, × diagonal; infinite if most points lie behind."""
    local = xyz @ pose[:, :3].T + pose[:, 3]
    front = local[:, 2] > 0
    if front.mean() < 0.5:
        return float("inf")
    with np.errstate(invalid="ignore", over="ignore"):
        distances = np.linalg.norm(camera.img_from_cam(local[front]) - pixels[front], axis=1)
    distances = np.where(np.isfinite(distances), distances, np.inf)
    return float(np.median(distances)) / float(np.hypot(camera.width, camera.height))

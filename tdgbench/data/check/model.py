"""Find cameras whose numbers are valid but wrong: their points do not project to where the images show them."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pycolmap

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap.model import model_files
from tdgbench.scenes.inputs import read_bytes

FEWEST = 10  # points of a view from which it is judged
FAR = 0.05  # median error of a wrong view, × diagonal of the image; COLMAP drops what is 4 px off, some 0.005


def wrong_views(folder: Path) -> list[str]:
    """Return a problem per view of a COLMAP model whose points project far from where it shows them.

    Models without 2-D points, and ones that pycolmap does not read, have none. Points may have been removed.
    """
    with TemporaryDirectory(prefix="tdgbench-") as place:
        try:
            for path in model_files(folder):  # without frames and rigs, whose counts pycolmap believes
                Path(place, path.name).write_bytes(read_bytes(path))
            model = pycolmap.Reconstruction(place)
        except (SceneError, ValueError, RuntimeError, LookupError):
            return []
    problems = []
    for image in model.images.values():
        observed = [point for point in image.get_observation_points2D() if point.point3D_id in model.points3D]
        shown = [(point.xy, model.points3D[point.point3D_id].xyz) for point in observed]
        if len(shown) < FEWEST:
            continue
        seen = [(xy, image.project_point(xyz)) for xy, xyz in shown]
        errors = [np.inf if place is None else float(np.linalg.norm(xy - place)) for xy, place in seen]
        share = float(np.median(errors)) / float(np.hypot(image.camera.width, image.camera.height))
        if share > FAR:
            off = f"project {share:.0%} of the diagonal off" if np.isfinite(share) else "lie behind it"
            problems.append(
                f"{image.name}: the points that it shows {off}; its pose or its camera in {folder} is wrong"
            )
    return problems

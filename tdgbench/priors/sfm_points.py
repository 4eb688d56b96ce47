"""Dense inverse depth from the scene's sparse points, interpolated over the image but not across thermal edges.

Minimises  Σ_points w (d_i − z_i)² + λ Σ_neighbours exp(−(ΔT / σ)²) (d_i − d_j)²  over inverse depth d on a coarse grid.
Planes are linear in inverse depth. Needs no network.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt
from scipy.linalg import solveh_banded
from scipy.ndimage import minimum_filter

from tdgbench.priors.prior import DepthPrior, PriorError
from tdgbench.scenes import Camera, Scene, View
from tdgbench.scenes.images import resize

OFFER = "(from RGB images' geometry: TDg then has more than thermal images; counts for no claim)"
WINDOW = 5  # cells; side of the square in which nearer points hide others
POINTS_IN_WINDOW = 4  # that should lie in that square
GRID = (24, 160)  # fewest and most columns of a grid in which points hide others
MIN_POINTS = 8


class VisiblePoints(NamedTuple):
    """Points by the pixel of a camera in which they lie; all arrays have shape (N,)."""

    number: np.ndarray  # among the given points
    rows: np.ndarray
    columns: np.ndarray
    z: np.ndarray  # world units


def visible_points(camera: Camera, points: np.ndarray, occlusion: float) -> VisiblePoints:
    """Return the points (N, 3) inside the image that no other hides.

    A point is hidden if it lies more than the share `occlusion` behind the nearest one within 2 px. Points are sparse:
    use the camera of a small image (`camera.resized`).

    >>> camera = Camera(np.diag([8.0, 8.0, 1.0]), np.eye(4), width=8, height=8)
    >>> visible_points(camera, np.array([[0.5, 0.5, 1.0], [1.0, 1.0, 2.0], [-1.0, 0.0, 1.0]]), 0.1).z.tolist()
    [1.0]
    """
    pixels, z = camera.project(points)
    index = np.flatnonzero(camera.holds(pixels, z))
    columns, rows = pixels[index].astype(int).T
    z = z[index]
    nearest = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(nearest, (rows, columns), z)
    seen = z <= minimum_filter(nearest, size=WINDOW)[rows, columns] * (1 + occlusion)
    return VisiblePoints(index[seen], rows[seen], columns[seen], z[seen])


def grid_width(cameras: Sequence[Camera], points: np.ndarray) -> int:
    """Return columns of a small image in which about POINTS_IN_WINDOW of the points (N, 3) in it share a window."""
    inside = sum(int(np.count_nonzero(camera.shows(points))) for camera in cameras)
    cells = WINDOW**2 * inside / len(cameras) / POINTS_IN_WINDOW
    return int(np.clip(np.sqrt(cells * cameras[0].width / cameras[0].height), *GRID))


@dataclass
class SfmPointsPrior:
    """Prior of kind `disparity`, in inverse world units.

    grid_width: columns of the grid. edge: σ, the thermal difference (of [0, 1]) of an edge. smoothness: λ. occlusion:
    a point is hidden if it lies more than this share behind the nearest point within 2 cells.
    """

    grid_width: PositiveInt
    edge: PositiveFloat
    smoothness: PositiveFloat
    occlusion: NonNegativeFloat

    def identity(self, scene: Scene) -> dict[str, object]:
        return {"estimator": "sfm_points", **vars(self)}

    def estimate(self, scene: Scene, view: View) -> DepthPrior:
        if scene.points is None:
            raise PriorError(f"{scene.name} has no sparse points; prior=sfm_points needs a COLMAP model with points")
        camera = view.camera
        width = min(self.grid_width, camera.width)
        height = max(1, round(camera.height * width / camera.width))
        inverse, weight = self._splat_points(scene.points.points, camera.resized(width, height))
        if np.count_nonzero(weight) < MIN_POINTS:
            raise PriorError(
                f"view {view.name} of {scene.name} sees sparse points in {np.count_nonzero(weight)} cells of a grid of "
                f"{width} × {height} cells; prior=sfm_points needs {MIN_POINTS}: raise data.width "
                "or prior.estimator.grid_width if they are small, or choose another prior"
            )
        thermal = resize(view.thermal, width, height).mean(axis=2)
        dense = self._solve(inverse, weight, thermal)
        if not np.isfinite(dense).all():
            raise PriorError(
                f"prior.estimator.smoothness={self.smoothness:g} and prior.estimator.edge={self.edge:g} give view "
                f"{view.name} of {scene.name} no finite depth; raise them"
            )
        full = resize(dense[..., None].astype(np.float32), camera.width, camera.height)[..., 0]
        return DepthPrior(full, "disparity")

    def _splat_points(self, points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
        """Return mean inverse depth (H, W) and number (H, W) of the visible points, of points (N, 3), per grid cell."""
        _, rows, columns, z = visible_points(camera, points, self.occlusion)
        total, count = np.zeros((camera.height, camera.width)), np.zeros((camera.height, camera.width))
        np.add.at(total, (rows, columns), 1 / z)
        np.add.at(count, (rows, columns), 1)
        return np.divide(total, count, out=np.zeros_like(total), where=count > 0), count

    def _solve(self, values: np.ndarray, weight: np.ndarray, thermal: np.ndarray) -> np.ndarray:
        """Return the minimiser (H, W) for data `values` with `weight` and edges of `thermal`, all (H, W).

        It is NaN where rounding leaves the system without a solution.
        """
        if values.shape[0] < values.shape[1]:  # the band of the matrix is as wide as a row
            return self._solve(values.T, weight.T, thermal.T).T
        columns = values.shape[1]
        right, down = np.zeros((2, *values.shape))  # λ exp(−(ΔT / σ)²) with the neighbour; 0 at the border
        right[:, :-1], down[:-1] = (
            self.smoothness * np.maximum(np.exp(-((np.diff(thermal, axis=axis) / self.edge) ** 2)), 1e-3)
            for axis in (1, 0)
        )
        band = np.zeros((columns + 1, values.size))  # lower diagonals
        band[0] = (weight + right + down).ravel()
        band[0, 1:] += right.ravel()[:-1]
        band[0, columns:] += down.ravel()[:-columns]
        band[1] -= right.ravel()
        band[columns] -= down.ravel()
        try:
            solution = solveh_banded(band, (weight * values).ravel(), overwrite_ab=True, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return np.full(values.shape, np.nan)
        return solution.reshape(values.shape)

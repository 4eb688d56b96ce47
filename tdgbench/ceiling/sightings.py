"""Sightings: (point, view) pairs in which no other point hides the point. Their arrays have shape (S, …)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import ndimage, sparse

from tdgbench.priors.visible import WINDOW, VisiblePoints, visible_points
from tdgbench.scenes import Camera, View

OCCLUSION = 0.1  # a point this share behind its neighbours is hidden
POINTS_IN_WINDOW = 4  # that should lie in the window in which nearer points hide others
GRID = (24, 160)  # columns of the grid that hides points
MOST_POINTS = 6_000  # whose values are compared
FEWEST_VIEWS = 4  # that must see a point
CLEARANCE = 1 / 32  # share of the width to where the depth changes; nearer, a blurred pixel shows two surfaces
CHANGE = 0.08  # share of the depth; more is another surface
BLOCK = 1 / 5  # of the image's width, side of the blocks of points that belong to one half
BORDER = 0.05  # of a block's side


@dataclass(frozen=True)
class Sightings:
    """point, view: (S,) indices, by view. points: (P, 3), world units. cameras: of the views, given or registered."""

    point: np.ndarray
    view: np.ndarray
    points: np.ndarray
    cameras: tuple[Camera, ...]

    def kept(self, keep: np.ndarray) -> Sightings:
        """The sightings where `keep` (S,) is true."""
        return replace(self, point=self.point[keep], view=self.view[keep])

    def usable(self, keep: np.ndarray) -> np.ndarray:
        """Those (S,) of the sightings to keep (S,) whose point enough views see among them."""
        return keep & (np.bincount(self.point[keep], minlength=len(self.points)) >= FEWEST_VIEWS)[self.point]

    def resized(self, side: int) -> Sightings:
        """The sightings in images of blocks of `side` px."""
        cameras = (camera.resized(camera.width // side, camera.height // side) for camera in self.cameras)
        return replace(self, cameras=tuple(cameras))

    def rows(self) -> list[slice]:
        """The sightings of each view."""
        ends = np.searchsorted(self.view, np.arange(len(self.cameras) + 1))
        return [slice(first, last) for first, last in pairwise(ends)]

    def pixels(self, cameras: Sequence[Camera]) -> np.ndarray:
        """Where (S, 2) the cameras show the points: x and y, px."""
        return np.concatenate([camera.project(points)[0] for camera, points in zip(cameras, self._seen(), strict=True)])

    def depths(self) -> np.ndarray:
        """Depths (S,) of the points in the views, world units."""
        return np.concatenate(
            [camera.project(points)[1] for camera, points in zip(self.cameras, self._seen(), strict=True)]
        )

    def _seen(self) -> list[np.ndarray]:
        """Points (N, 3) of each view."""
        return [self.points[self.point[rows]] for rows in self.rows()]

    def sums(self, values: np.ndarray) -> np.ndarray:
        """For each sighting, the sum (S,) of `values` (S,) over all of its point's."""
        return np.bincount(self.point, values, minlength=len(self.points))[self.point]

    def mean_of_others(self, values: np.ndarray) -> np.ndarray:
        """For each sighting, the mean (S, …) of `values` (S, …) over its point's others that are not NaN; 0 if none."""
        if values.ndim > 1:
            return np.stack([self.mean_of_others(one) for one in values.T], axis=1)
        counts = ~np.isnan(values)
        known = np.where(counts, values, 0.0)
        return (self.sums(known) - known) / np.maximum(self.sums(counts.astype(float)) - counts, 1)

    def median(self, values: np.ndarray) -> np.ndarray:
        """For each sighting, the median (S,) of `values` (S,) over all of its point's."""
        order = np.lexsort((values, self.point))
        number = np.bincount(self.point, minlength=len(self.points))
        middle = np.cumsum(number) - number + (number - 1) // 2
        return np.asarray(values[order][np.minimum(middle, len(values) - 1)][self.point])

    def contrast(self) -> np.ndarray:
        """What views differ by from the others that see the same points: a matrix C (V, V).

        If each view adds t_v to the values of all points, its mean difference from the means of the points' other views
        is Σ_j C_vj t_j: C_vv is 1, C_vj the mean of −1 / (n − 1) over v's points that j sees too, n views see a point.
        """
        shape = (len(self.cameras), len(self.points))
        seen = sparse.csr_array((np.ones(len(self.point)), (self.view, self.point)), shape=shape)
        others = sparse.diags_array(1 / np.maximum(seen.sum(axis=0) - 1, 1))
        matrix = -(seen @ others @ seen.T).toarray() / np.maximum(seen.sum(axis=1), 1)[:, None]
        np.fill_diagonal(matrix, 1.0)
        return np.asarray(matrix)

    def halves(self) -> tuple[np.ndarray, np.ndarray]:
        """Which sightings (S,) belong to the one and the other half of the points, in blocks like a chessboard's.

        Points near a block's border belong to neither, so that the halves share no noise of pixels.
        """
        camera = self.cameras[0]
        z = np.median(np.abs(camera.project(self.points)[1]))
        blocks, place = np.divmod(self.points / (BLOCK * camera.width * z / camera.K[0, 0]), 1.0)
        inner = (np.abs(place - 0.5) <= 0.5 - BORDER).all(axis=1)
        odd = blocks.sum(axis=1) % 2 == 1
        return (inner & ~odd)[self.point], (inner & odd)[self.point]


def find_sightings(views: Sequence[View], points: np.ndarray) -> Sightings:
    """The sightings of points (N, 3) in views, of MOST_POINTS points at most, that lie clear of depth edges."""
    chosen = np.zeros(len(points), bool)
    chosen[:: max(1, -(-len(points) // MOST_POINTS))] = True
    cameras = tuple(view.camera for view in views)
    width = _grid_width(cameras, points)
    seen = []
    for camera in cameras:
        height = max(1, round(camera.height * width / camera.width))
        visible = visible_points(camera.resized(width, height), points, OCCLUSION)
        seen.append(visible.number[chosen[visible.number] & _is_clear(visible, (height, width))])
    view = np.repeat(np.arange(len(views)), [len(one) for one in seen])
    everything = Sightings(np.cumsum(chosen)[np.concatenate(seen)] - 1, view, points[chosen], cameras)
    return everything.kept(everything.usable(np.ones(len(view), bool)))


def _is_clear(visible: VisiblePoints, shape: tuple[int, int]) -> np.ndarray:
    """Which visible points (N,) lie farther than CLEARANCE from others whose depth differs by more than CHANGE."""
    nearest, farthest = np.full(shape, np.inf), np.zeros(shape)
    np.minimum.at(nearest, (visible.rows, visible.columns), visible.z)
    np.maximum.at(farthest, (visible.rows, visible.columns), visible.z)
    size = 2 * int(np.ceil(CLEARANCE * shape[1])) - 1
    near = ndimage.minimum_filter(nearest, size)[visible.rows, visible.columns]
    far = ndimage.maximum_filter(farthest, size)[visible.rows, visible.columns]
    return np.asarray((near * (1 + CHANGE) >= visible.z) & (visible.z * (1 + CHANGE) >= far))


def _grid_width(cameras: Sequence[Camera], points: np.ndarray) -> int:
    """Columns of a grid in which about POINTS_IN_WINDOW points of those in the image share a window."""
    inside = 0
    for camera in cameras:
        pixels, z = camera.project(points)
        size = (camera.width, camera.height)
        inside += int(np.count_nonzero((z > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)))
    cells = WINDOW**2 * inside / len(cameras) / POINTS_IN_WINDOW
    return int(np.clip(np.sqrt(cells * cameras[0].width / cameras[0].height), *GRID))

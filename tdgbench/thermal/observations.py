"""Values of training views at the sparse points of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import ndimage
from scipy.cluster.vq import kmeans2

from tdgbench.priors.sfm_points import grid_width, visible_points
from tdgbench.scenes import Camera, View
from tdgbench.scenes.images import nearest_valid
from tdgbench.thermal.maps import legendre_basis

MOST_POINTS = 20_000
OCCLUSION = 0.05  # a point this share behind a nearer neighbour is hidden
BLUR = 1.0  # px, σ; values are those of the blurred image, which has less noise
MARGIN = 2  # px; pixels up to this far must be valid
SATURATED = 1e-3  # image values this near to 0 and 1 may be clipped
CLUSTERS = 10  # of points
FAR = 4.0  # median distances from the middle
FEWEST_VIEWS = 3  # that must see a point
PATCHES = 8  # columns and rows of patches of a view


@dataclass(frozen=True)
class PointSamples:
    """S pairs of a point and one of V training views that sees it.

    point, view: (S,) indices. value: (S,) of the blurred image. slope: (S,) length of the gradient, per px. x, y: (S,)
    position in px. terms: (S, K) polynomials there. cluster: (S,) of points that lie together. sizes: (V, 2) width and
    height of the views, px. points: number of points.
    """

    point: np.ndarray
    view: np.ndarray
    value: np.ndarray
    slope: np.ndarray
    x: np.ndarray
    y: np.ndarray
    terms: np.ndarray
    cluster: np.ndarray
    sizes: np.ndarray
    points: int

    def select(self, keep: np.ndarray) -> PointSamples:
        """Return the pairs where `keep` (S,) is true; views and points keep their numbers."""
        names = ("point", "view", "value", "slope", "x", "y", "terms", "cluster")
        return replace(self, **{name: getattr(self, name)[keep] for name in names})

    def shared(self) -> PointSamples:
        """Return the pairs of points that enough views see; points are counted anew."""
        seen = self.select((np.bincount(self.point, minlength=self.points) >= FEWEST_VIEWS)[self.point])
        left, point = np.unique(seen.point, return_inverse=True)
        return replace(seen, point=point, points=len(left))

    @property
    def views(self) -> int:
        return len(self.sizes)

    @cached_property
    def patch(self) -> np.ndarray:
        """(S,) patch of a view, one of PATCHES × PATCHES, in which each lies."""
        across, down = (np.stack([self.x, self.y], axis=1) / self.sizes[self.view] * PATCHES).astype(int).T
        return np.asarray((self.view * PATCHES + down) * PATCHES + across)

    @property
    def ideal(self) -> np.ndarray:
        """Offsets, gains and coefficients (2 V + K,) of an ideal camera."""
        return np.repeat([0.0, 1.0, 0.0], [self.views, self.views, self.terms.shape[1]])


def find_observations(views: Sequence[View], points: np.ndarray) -> PointSamples:
    """Find observations of at most MOST_POINTS of the points (N, 3), in views with thermal images of one channel."""
    used = np.zeros(len(points), bool)
    used[:: max(1, -(-len(points) // MOST_POINTS))] = True
    parts: list[tuple[np.ndarray, ...]] = []
    for index, view in enumerate(views):
        number, x, y = _seen(view.camera, points, used)
        value, slope, usable = _values(view, x, y)
        whole = (number, np.full(len(number), index), value, slope, x, y)
        parts.append(tuple(array[usable] for array in whole))
    point, of_view, value, slope, x, y = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    sizes = np.array([(view.camera.width, view.camera.height) for view in views])
    terms, cluster = legendre_basis(*(np.stack([x, y]) / sizes[of_view].T)), _clusters(points)[point]
    return PointSamples(point, of_view, value, slope, x, y, terms, cluster, sizes, len(points)).shared()


def _clusters(points: np.ndarray) -> np.ndarray:
    """Return the cluster (N,) of each point (N, 3), by k-means; the coordinates of far points are clipped first."""
    middle, size = np.median(points, axis=0), np.median(np.abs(points - np.median(points, axis=0)), axis=0)
    near = np.clip((points - middle) / max(float(size.max()), 1e-12), -FAR, FAR)
    return np.asarray(kmeans2(near, min(CLUSTERS, len(points)), seed=0, minit="++")[1])


def _seen(camera: Camera, points: np.ndarray, used: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return numbers and positions x and y in px of the `used` points that a camera sees; all points hide others."""
    width = min(grid_width([camera], points), camera.width)
    grid = camera.resized(width, max(1, round(camera.height * width / camera.width)))
    number = visible_points(grid, points, OCCLUSION).number
    number = number[used[number]]
    pixels, _ = camera.project(points[number])
    return number, pixels[:, 0], pixels[:, 1]


def _values(view: View, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return values and slopes at positions in px, and whether each was measured.

    A value is that of the blurred pixel, moved from its centre to the position by the gradient.
    """
    image = nearest_valid(view.thermal.mean(axis=2, dtype=np.float64), view.valid)  # a blur mixes pixels
    height, width = image.shape
    row, column = np.clip(y.astype(int), 0, height - 1), np.clip(x.astype(int), 0, width - 1)
    smooth = ndimage.gaussian_filter(image, BLUR, mode="nearest")
    down, right = (slope[row, column] for slope in np.gradient(smooth))
    value = smooth[row, column] + down * (y - row - 0.5) + right * (x - column - 0.5)
    size = 2 * MARGIN + 1
    unusable = (ndimage.minimum_filter(image, size) < SATURATED) | (ndimage.maximum_filter(image, size) > 1 - SATURATED)
    if view.valid is not None:
        unusable |= ndimage.minimum_filter(view.valid, size) == 0
    return value, np.hypot(down, right), ~unusable[row, column]

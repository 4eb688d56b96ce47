"""Points from multi-view stereo on the thermal training images with the given poses; no RGB image, no test view.

A plane sweep: each pixel gets the depth at which its surroundings look most alike in the nearest views, or, without
texture, that of its neighbours. Depths that other views confirm become points, at the mean of what these views find.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, PositiveFloat, PositiveInt
from scipy.ndimage import map_coordinates, uniform_filter

from tdgbench.scenes import Camera, PointCloud, Scene, SceneError, View
from tdgbench.scenes.images import resize

FLAT = 1e-10  # variance of a window without texture


class Picture(NamedTuple):
    """A view's thermal image as the sweep sees it."""

    camera: Camera
    gray: np.ndarray  # (H, W) float32 in [0, 1]
    known: np.ndarray  # (H, W) bool, without masked pixels


@dataclass
class ThermalStereo:
    """Plane sweep with normalised cross-correlation, which drift and gain of the thermal camera do not change.

    width: of the images that are compared, px, at most. window: side of what is compared, px. planes: depths in
    geometric progression from `near` to `far`, × scene extent. neighbours: views that a view is compared with, the
    nearest that are at least `baseline` × extent away and whose optical axis is less than `degrees` off; the better
    half counts, as others may be occluded. slant, jump: penalties of `aggregated`. cost: greatest one of a
    depth, where that is 1 − correlation. These three are × the median over pixels of the least cost, so that noise is
    smoothed and detail is not. agreeing: other views whose depth is the same, to the share `tolerance`. spacing: of the
    points, × median depth; the points of a cell become their mean.
    """

    width: Annotated[int, Field(ge=16)]
    window: Annotated[int, Field(ge=3)]
    planes: Annotated[int, Field(ge=3)]
    near: PositiveFloat
    far: PositiveFloat
    neighbours: PositiveInt
    baseline: PositiveFloat
    degrees: PositiveFloat
    slant: PositiveFloat
    jump: PositiveFloat
    cost: PositiveFloat
    agreeing: PositiveInt
    tolerance: PositiveFloat
    spacing: PositiveFloat

    def points(self, scene: Scene) -> PointCloud:
        pictures = [self._picture(view) for view in scene.train]
        depths = [self._depth(index, pictures, scene.extent) for index in range(len(pictures))]
        found = [self._confirmed(index, pictures, depths) for index in range(len(pictures))]
        points, grays = (np.concatenate(parts) for parts in zip(*found, strict=True))
        if not len(points):
            raise SceneError(
                f"{scene.name}: no depth of a thermal training image agrees with that of {self.agreeing} others; use "
                "init=random, or set init.points.near and init.points.far to the scene's depths (× extent)"
            )
        median = np.nanmedian(np.concatenate([depth.ravel() for depth in depths]))
        cells = np.floor(points / (self.spacing * median)).astype(np.int64)
        _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        means = [np.bincount(cell.ravel(), values) / count for values in (*points.T, grays)]
        return PointCloud(np.stack(means[:3], axis=1), np.repeat(means[3][:, None], 3, axis=1).astype(np.float32))

    def describe(self, scene: Scene, cloud: PointCloud) -> dict[str, object]:
        how = f"multi-view stereo of the thermal training images, depths that {self.agreeing} other views confirm"
        return {"kind": "mvs_thermal", "points": len(cloud.points), "how": how}

    def _picture(self, view: View) -> Picture:
        width = min(self.width, view.camera.width)
        camera = view.camera.resized(width, max(1, round(view.camera.height * width / view.camera.width)))
        valid = np.ones(view.thermal.shape[:2], np.float32) if view.valid is None else view.valid.astype(np.float32)
        gray = resize(view.thermal, camera.width, camera.height).mean(axis=2)
        known = resize(valid[..., None], camera.width, camera.height)[..., 0] > 1 - 1e-6
        return Picture(camera, gray, self._mean(known.astype(np.float32)) > 1 - 1e-6)

    def _depth(self, index: int, pictures: list[Picture], extent: float) -> np.ndarray:
        """Return depths (H, W) of a view, world units; NaN where no depth is alike enough or none was measured."""
        camera, gray, known = pictures[index]
        others = self._neighbours(index, pictures, extent)
        if not others or not known.any():
            return np.full(gray.shape, np.nan)
        depths = np.geomspace(self.near * extent, self.far * extent, self.planes)
        rays, mean = _rays(camera), self._mean(gray)
        deviation = np.sqrt(np.maximum(self._mean(gray**2) - mean**2, FLAT))
        alike = np.empty((self.planes, *gray.shape), np.float32)
        for number, z in enumerate(depths):
            scores = []
            for other in others:
                pixels, behind = other.camera.project(camera.center + rays * z)
                seen = map_coordinates(other.gray, pixels.T[::-1] - 0.5, order=1, mode="nearest").reshape(gray.shape)
                seen_mean = self._mean(seen)
                seen_deviation = np.sqrt(np.maximum(self._mean(seen**2) - seen_mean**2, FLAT))
                score = (self._mean(gray * seen) - mean * seen_mean) / (deviation * seen_deviation)
                scores.append(np.where(other.camera.holds(pixels, behind).reshape(gray.shape), score, -1))
            alike[number] = np.sort(scores, axis=0)[len(scores) // 2 :].mean(axis=0)
        costs = 1 - alike
        typical = float(np.median(costs.min(axis=0)[known]))
        smooth = aggregated(np.where(known, costs, 0), self.slant * typical, self.jump * typical)
        best = smooth[1:-1].argmin(axis=0)[None] + 1  # not the first and last: the minimum may lie beyond
        before, least, after = (np.take_along_axis(smooth, best + step, axis=0)[0] for step in (-1, 0, 1))
        curvature = np.maximum(before - 2 * least + after, 1e-6)
        between = np.clip((before - after) / (2 * curvature), -0.5, 0.5)  # vertex of the parabola through the three
        alike_enough = np.take_along_axis(costs, best, axis=0)[0] <= self.cost * typical
        sharp = (least < np.minimum(before, after)) & alike_enough & known
        return np.where(sharp, depths[0] * (depths[1] / depths[0]) ** (best[0] + between), np.nan)

    def _mean(self, image: np.ndarray) -> np.ndarray:
        return uniform_filter(image, self.window, mode="nearest")

    def _neighbours(self, index: int, pictures: list[Picture], extent: float) -> list[Picture]:
        camera = pictures[index].camera
        apart = [float(np.linalg.norm(other.camera.center - camera.center)) for other in pictures]
        cosines = [other.camera.world_to_camera[2, :3] @ camera.world_to_camera[2, :3] for other in pictures]
        fits = [
            number
            for number in np.argsort(apart, kind="stable")
            if apart[number] >= self.baseline * extent and cosines[number] > np.cos(np.radians(self.degrees))
        ]
        return [pictures[number] for number in fits[: self.neighbours]]

    def _confirmed(
        self, index: int, pictures: list[Picture], depths: list[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return world points (N, 3) of a view's depths that enough other views share, and their gray values (N,).

        A depth is replaced by the mean over its view and those that share it, as each has its own error of matching.
        """
        camera, gray, _ = pictures[index]
        z, found = depths[index].ravel(), np.isfinite(depths[index]).ravel()
        steps = _rays(camera)[found] * z[found, None]
        points = camera.center + steps
        agreeing, ratios = np.zeros(len(points), int), np.ones(len(points))
        for number, (other, depth) in enumerate(zip(pictures, depths, strict=True)):
            if number != index:
                pixels, expected = other.camera.project(points)
                seen = np.flatnonzero(other.camera.holds(pixels, expected))
                columns, rows = pixels[seen].astype(int).T
                ratio = depth[rows, columns] / expected[seen]
                same = np.abs(ratio - 1) < self.tolerance
                agreeing[seen[same]] += 1
                ratios[seen[same]] += ratio[same]
        kept = agreeing >= self.agreeing
        means = camera.center + steps * (ratios / (agreeing + 1))[:, None]
        return means[kept], gray.ravel()[found][kept]


def _rays(camera: Camera) -> np.ndarray:
    """Return directions (H · W, 3) in the world of a camera's pixels, at depth 1."""
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    pixels = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1)
    return pixels @ np.linalg.inv(camera.K).T @ camera.world_to_camera[:3, :3]


def aggregated(cost: np.ndarray, slant: float, jump: float) -> np.ndarray:
    """Return matching costs (planes, H, W) as means over the eight straight paths to each pixel.

    Semi-global matching (Hirschmüller 2008, eq. 13): depths that neighbours share where texture is weak. slant:
    penalty of neighbours on a path that are one plane apart. jump: of those further apart.

    >>> cost = np.ones((4, 1, 3))
    >>> cost[1, 0, [0, 2]] = 0  # the pixel in the middle has no texture
    >>> aggregated(cost, 0.4, 2.0).argmin(axis=0).tolist()
    [[1, 1, 1]]
    """
    total = np.zeros_like(cost)
    for way in (1, -1):
        for shift in (-1, 0, 1):
            total[:, ::way] += _down(cost[:, ::way], shift, slant, jump)
        total.swapaxes(1, 2)[:, ::way] += _down(cost.swapaxes(1, 2)[:, ::way], 0, slant, jump)
    return total / 8


def _down(cost: np.ndarray, shift: int, slant: float, jump: float) -> np.ndarray:
    """Return path costs (planes, H, W) from the first row on; the column before x is x − shift."""
    path = cost.copy()
    for row in range(1, cost.shape[1]):
        before = np.zeros_like(cost[:, 0])
        inside = slice(max(shift, 0), before.shape[1] + min(shift, 0))
        before[:, inside] = np.roll(path[:, row - 1], shift, axis=1)[:, inside]
        least = before.min(axis=0)
        beside = np.pad(before, ((1, 1), (0, 0)), constant_values=np.inf)
        beside = np.minimum(beside[:-2], beside[2:]) + slant
        path[:, row] += np.minimum(np.minimum(before, beside), least + jump) - least
    return path

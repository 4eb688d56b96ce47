"""Sightings: what training views show at the scene's sparse points.

A sighting is one (point, view) pair in which no other point hides the point. Arrays of sightings have shape (S, …).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from tdgbench.priors.visible import WINDOW, VisiblePoints, visible_points
from tdgbench.scenes import Camera, View

OCCLUSION = 0.1  # a point this share behind its neighbours is hidden
POINTS_IN_WINDOW = 4  # that should lie in the window in which nearer points hide others
GRID = (24, 160)  # columns of the grid that hides points
MOST_POINTS = 8_000  # whose values are compared
CHANGE = 0.08  # share of the depth; more is another surface
REACH = 6  # cells within which depths are compared
FEWEST_VIEWS = 4  # that must see a point
SUBPIXEL = 1.0  # px, σ of the blur of gradients inside a pixel
INSIDE = 0.99  # share of a blurred pixel's weight that must be valid


@dataclass(frozen=True)
class Sightings:
    """point, view: (S,) indices. clearance: (S,) px to where the depth changes. points: (P, 3), world units.

    cameras: of the views.
    """

    point: np.ndarray
    view: np.ndarray
    clearance: np.ndarray
    points: np.ndarray
    cameras: tuple[Camera, ...]

    def kept(self, keep: np.ndarray) -> Sightings:
        """The sightings where `keep` (S,) is true, without those of points that too few views see."""
        counts = np.bincount(self.point[keep], minlength=len(self.points))
        keep = keep & (counts >= FEWEST_VIEWS)[self.point]
        return replace(self, point=self.point[keep], view=self.view[keep], clearance=self.clearance[keep])


class Samples(NamedTuple):
    """Values of blurred images at sightings, C channels. moves: of the pixel by one world unit, (S, 2, 3)."""

    values: np.ndarray  # (S, C)
    gradients: np.ndarray  # (S, C, 2), per px along x and y
    moves: np.ndarray
    inside: np.ndarray  # (S,) bool: the point lies in the image, at valid pixels


def find_sightings(views: Sequence[View], points: np.ndarray) -> Sightings:
    """The sightings of points (N, 3) in views, of MOST_POINTS points at most."""
    chosen = np.zeros(len(points), bool)
    chosen[:: max(1, -(-len(points) // MOST_POINTS))] = True
    cameras = tuple(view.camera for view in views)
    width = _grid_width(cameras, points)
    seen, clear = [], []
    for camera in cameras:
        height = max(1, round(camera.height * width / camera.width))
        visible = visible_points(camera.resized(width, height), points, OCCLUSION)
        among = chosen[visible.number]
        seen.append(visible.number[among])
        clear.append(_clearance(visible, (height, width), camera.width / width)[among])
    point = np.concatenate(seen)
    view = np.repeat(np.arange(len(views)), [len(one) for one in seen])
    everything = Sightings(np.cumsum(chosen)[point] - 1, view, np.concatenate(clear), points[chosen], cameras)
    return everything.kept(np.ones(len(point), bool))


def _clearance(visible: VisiblePoints, shape: tuple[int, int], cell: float) -> np.ndarray:
    """Distance (N,) in px within which no visible point's depth differs by more than CHANGE, in whole cells."""
    nearest, farthest = np.full(shape, np.inf), np.zeros(shape)
    np.minimum.at(nearest, (visible.rows, visible.columns), visible.z)
    np.maximum.at(farthest, (visible.rows, visible.columns), visible.z)
    clear = np.zeros(len(visible.z))
    for radius in range(REACH + 1):
        size = 2 * radius + 1
        near = ndimage.minimum_filter(nearest, size)[visible.rows, visible.columns]
        far = ndimage.maximum_filter(farthest, size)[visible.rows, visible.columns]
        same = (near * (1 + CHANGE) >= visible.z) & (visible.z * (1 + CHANGE) >= far)
        clear[same & (clear == radius * cell)] = (radius + 1) * cell
    return clear


def _grid_width(cameras: Sequence[Camera], points: np.ndarray) -> int:
    """Columns of a grid in which about POINTS_IN_WINDOW points of those in the image share a window."""
    inside = 0
    for camera in cameras:
        pixels, z = camera.project(points)
        size = (camera.width, camera.height)
        inside += int(np.count_nonzero((z > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)))
    cells = WINDOW**2 * inside / len(cameras) / POINTS_IN_WINDOW
    return int(np.clip(np.sqrt(cells * cameras[0].width / cameras[0].height), *GRID))


def sample(views: Sequence[View], sightings: Sightings, blur: float) -> Samples:
    """What the views show at the sightings, blurred by a Gaussian of σ = `blur` px."""
    total, channels = len(sightings.point), views[0].thermal.shape[2]
    values, gradients = np.zeros((total, channels)), np.zeros((total, channels, 2))
    moves, inside = np.zeros((total, 2, 3)), np.zeros(total, bool)
    for index, view in enumerate(views):
        rows = np.flatnonzero(sightings.view == index)
        positions, camera = sightings.points[sightings.point[rows]], sightings.cameras[index]
        pixels, z = camera.project(positions)
        moves[rows] = pixel_moves(camera, positions)
        at = pixels[:, ::-1].T - 0.5  # rows, columns; pixel centres at integers
        inside[rows] = (z > 0) & _inside(view, at, blur)
        for channel in range(channels):
            smooth = blurred(view.thermal[..., channel], view.valid, blur)
            values[rows, channel] = _between(smooth, at)
            gradients[rows, channel] = np.stack([_between(slope, at) for slope in np.gradient(smooth)[::-1]], axis=1)
    return Samples(values, gradients, moves, inside)


def sample_pixels(
    views: Sequence[View], sightings: Sightings, change: Callable[[np.ndarray, np.ndarray | None], np.ndarray]
) -> np.ndarray:
    """Values (S, C) of the pixels in which the points lie, in images that `change` makes of an image and its mask.

    They are moved from the pixel's centre to the point by a gradient that has little of the pixel's noise.
    """
    values = np.zeros((len(sightings.point), views[0].thermal.shape[2]))
    for index, view in enumerate(views):
        rows = np.flatnonzero(sightings.view == index)
        pixels, _ = sightings.cameras[index].project(sightings.points[sightings.point[rows]])
        at = pixels[:, ::-1].T - 0.5
        pixel = np.clip(np.rint(at), 0, [[view.camera.height - 1], [view.camera.width - 1]]).astype(int)
        for channel in range(values.shape[1]):
            image = view.thermal[..., channel]
            slopes = np.stack([_between(one, at) for one in np.gradient(blurred(image, view.valid, SUBPIXEL))])
            values[rows, channel] = change(image, view.valid)[tuple(pixel)] + (slopes * (at - pixel)).sum(axis=0)
    return values


def _between(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values (N,) of an image (H, W) at rows and columns (2, N)."""
    return ndimage.map_coordinates(image, at, order=1, mode="nearest")


def blurred(image: np.ndarray, valid: np.ndarray | None, blur: float) -> np.ndarray:
    """An image (H, W) blurred by a Gaussian of σ = `blur` px, over its valid pixels."""
    if valid is None:
        return ndimage.gaussian_filter(image, blur, mode="nearest")
    weight = ndimage.gaussian_filter(valid.astype(np.float32), blur, mode="nearest")
    total = ndimage.gaussian_filter(np.where(valid, image, np.float32(0)), blur, mode="nearest")
    return total / np.maximum(weight, 1e-6)


def _inside(view: View, at: np.ndarray, blur: float) -> np.ndarray:
    """Which of the rows and columns (2, N) lie in the image, and on valid pixels only within the blur."""
    size = np.array([view.camera.height, view.camera.width])[:, None]
    inside = ((at >= 0) & (at <= size - 1)).all(axis=0)
    if view.valid is not None:
        weight = ndimage.gaussian_filter(view.valid.astype(np.float32), blur, mode="nearest")
        inside &= ndimage.map_coordinates(weight, at, order=1, mode="nearest") >= INSIDE
    return np.asarray(inside)


def pixel_moves(camera: Camera, positions: np.ndarray) -> np.ndarray:
    """Derivative (N, 2, 3) of the pixel with respect to the position (N, 3) in world units."""
    rotation = camera.world_to_camera[:3, :3]
    local = positions @ rotation.T + camera.world_to_camera[:3, 3]
    depth = np.where(local[:, 2] > 0, local[:, 2], 1.0)
    focal = camera.K[[0, 1], [0, 1]]
    rows = rotation[None, :2] - (local[:, :2] / depth[:, None])[:, :, None] * rotation[None, 2:3]
    return rows * focal[None, :, None] / depth[:, None, None]

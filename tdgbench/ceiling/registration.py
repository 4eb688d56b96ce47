"""Register the views with one another by their thermal values at the sparse points: by how much are their poses wrong?

For every view, turn and displace its camera until the view shows at the points what the other views show there on
average, as they are given. Errors of single points average out, since a view sees hundreds of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tdgbench.ceiling.images import SmallImage, between, blurred, shows
from tdgbench.ceiling.sightings import Sightings
from tdgbench.scenes import Camera

BLURS = (2.0, 2.0, 2.0, 1.0, 1.0)  # px of the small images, of the steps
REACH = 4.0  # times the blur, how far a step may go where the images say nothing
STEEPER = 1.5  # times steeper than in the point's other views: an outline that the other views do not show
OUTLIER = 4.0  # standard deviations, from which on a difference has no weight (Tukey's biweight)
MEDIAN_OF_SQUARE = 0.455  # of a standard normal number
LEAST = 1e-9  # variance of image values


class Samples(NamedTuple):
    """What small images show at sightings: values (S,), NaN outside; gradients (S, 2), per px along x and y."""

    values: np.ndarray
    gradients: np.ndarray


def steepness_at(images: Sequence[SmallImage], sightings: Sightings) -> tuple[np.ndarray, np.ndarray]:
    """Steepness (S,) of the images at the sightings' points, medians over views; which sightings are no outlines.

    Where a view is much steeper than others at the same point, an outline of something nearer runs through it.
    """
    layers = [_layers(image, BLURS[0]) for image in images]
    samples = _sample(images, layers, sightings, sightings.cameras)
    steepness = np.where(np.isnan(samples.values), np.inf, np.hypot(*samples.gradients.T))
    median = sightings.median(steepness)
    return median, steepness <= STEEPER * median + 0.2 * np.median(median)


def register(
    images: Sequence[SmallImage], sightings: Sightings, drift: np.ndarray, steepness: np.ndarray
) -> tuple[Camera, ...]:
    """The views' cameras after Gauss-Newton steps, each with an offset and gain of the view's values.

    images: of the views, of the size of the sightings' cameras. drift: (S,) is subtracted from their values. Views are
    compared with the other views as these are given, since views that move towards each other move to flat areas.
    """
    cameras, tones, previous = sightings.cameras, np.zeros((len(sightings.cameras), 2)), 0.0
    for blur in BLURS:
        if blur != previous:
            layers = [_layers(image, blur) for image in images]
            given, previous = _sample(images, layers, sightings, sightings.cameras).values - drift, blur
        now = _sample(images, layers, sightings, cameras)
        offset, gain = tones[sightings.view].T
        rest = (1 + gain) * (now.values - drift) + offset
        rest = rest - sightings.mean_of_others((1 + gain) * given + offset)
        changes = _changes(replace(sightings, cameras=cameras), now, rest, _weights(rest, steepness), REACH * blur)
        cameras = tuple(_moved(camera, one[:6]) for camera, one in zip(cameras, changes, strict=True))
        tones += changes[:, 6:] - changes[:, 6:].mean(axis=0)
    return cameras


def _changes(sightings: Sightings, now: Samples, rest: np.ndarray, weight: np.ndarray, reach: float) -> np.ndarray:
    """Turn, displacement, offset and gain (V, 8) of the views that make the differences `rest` (S,) smallest.

    reach: px, how far a camera moves the points where the images say nothing.
    """
    changes = []
    for camera, rows in zip(sightings.cameras, sightings.rows(), strict=True):
        effect = _effect(camera, sightings.points[sightings.point[rows]])
        slopes = (now.gradients[rows][:, :, None] * effect).sum(axis=1)
        slopes = np.nan_to_num(np.column_stack([slopes, np.ones(len(slopes)), now.values[rows]]))
        ridge = (effect**2).sum(axis=1).mean(axis=0) / reach**2 if len(effect) else np.ones(6)
        weighted = slopes * weight[rows, None]
        normal = weighted.T @ slopes + np.diag(np.append(ridge, [1.0, 1.0]) + 1e-9)
        changes.append(-np.linalg.solve(normal, weighted.T @ np.nan_to_num(rest[rows])))
    return np.array(changes)


def _layers(image: SmallImage, blur: float) -> np.ndarray:
    """The blurred image and its slopes along x and y: (3, h, w)."""
    smooth = blurred(image.image, image.valid, blur)
    return np.stack([smooth, *np.gradient(smooth)[::-1]])


def _sample(
    images: Sequence[SmallImage], layers: Sequence[np.ndarray], sightings: Sightings, cameras: Sequence[Camera]
) -> Samples:
    pixels = sightings.pixels(cameras)
    found = np.zeros((len(pixels), 3))
    for view, rows in enumerate(sightings.rows()):
        found[rows] = np.stack([between(layer, pixels[rows]) for layer in layers[view]], axis=1)
        found[rows, 0][~shows(cameras[view], images[view].valid, pixels[rows])] = np.nan
    return Samples(found[:, 0], found[:, 1:])


def _weights(rest: np.ndarray, steepness: np.ndarray) -> np.ndarray:
    """Weights (S,) of differences whose variance is c + s · steepness²; s is due to errors of the points."""
    squares, steep, known = rest**2, steepness**2, ~np.isnan(rest)
    low = steep <= np.median(steep)
    flat = _robust_mean(squares[known & low]) + LEAST
    slope = (_robust_mean(squares[known & ~low]) - flat) / max(_median(steep[known & ~low]), 1e-12)
    variance = flat + max(slope, 0.0) * steep
    return np.nan_to_num(np.maximum(1 - squares / (OUTLIER**2 * variance), 0) ** 2 / variance)


def _robust_mean(squares: np.ndarray) -> float:
    """Mean of squares of normal numbers, from their median."""
    return _median(squares) / MEDIAN_OF_SQUARE


def _median(values: np.ndarray) -> float:
    """0 if there are none."""
    return float(np.median(values)) if len(values) else 0.0


def _effect(camera: Camera, positions: np.ndarray) -> np.ndarray:
    """Derivative (N, 2, 6) of the pixels of positions (N, 3) by the camera's turn (radians) and displacement."""
    x, y, z = (positions @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]).T
    u, v, zero = x / z, y / z, np.zeros_like(z)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    horizontal = fx * np.stack([-u * v, 1 + u * u, -v, 1 / z, zero, -u / z], axis=1)
    vertical = fy * np.stack([-1 - v * v, u * v, u, zero, 1 / z, -v / z], axis=1)
    return np.stack([horizontal, vertical], axis=1)


def _moved(camera: Camera, change: np.ndarray) -> Camera:
    """The camera after a turn (radians) and displacement (6,), in its own axes."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(change[:3]).as_matrix()
    matrix[:3, 3] = change[3:]
    return Camera(camera.K, matrix @ camera.world_to_camera, camera.width, camera.height)

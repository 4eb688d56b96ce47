"""Register the views with one another by their thermal values at the sparse points: by how much are their poses wrong?

One step solves, for every view, for the turn and displacement of its camera that brings the view's values nearest to
the points' means over views. Errors of single points average out, since a view sees hundreds of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from tdgbench.ceiling.sightings import Samples, Sightings, pixel_moves
from tdgbench.ceiling.spread import MEDIAN_OF_SQUARE, means_by_point, sums_by_point
from tdgbench.scenes import Camera

ROUNDS = 8  # of the alternation between views and points' means
HUBER = 1.5  # standard deviations
LEAST_SCALE = 1e-6  # of image values


def step(sightings: Sightings, samples: Samples, blur: float) -> tuple[Camera, ...]:
    """The views' cameras after one step. Cameras move by few times `blur` px, where the images say little.

    Sightings are in the order of their views.
    """
    point, count, views = sightings.point, len(sightings.points), len(sightings.cameras)
    ends = np.searchsorted(sightings.view, np.arange(views + 1))
    parts = [slice(first, last) for first, last in pairwise(ends)]
    slopes = np.zeros((*samples.values.shape, 6))
    ridges = np.zeros((views, 6))
    for view, (camera, rows) in enumerate(zip(sightings.cameras, parts, strict=True)):
        effect = _effect(camera, sightings.points[point[rows]])
        slopes[rows] = np.matmul(samples.gradients[rows], effect)
        ridges[view] = (effect**2).sum(axis=1).mean(axis=0) / blur**2 if len(effect) else 1.0
    turns = np.zeros((views, 6))
    rest = samples.values - means_by_point(samples.values, point, count)[point]
    scale = np.sqrt(np.median(rest**2) / MEDIAN_OF_SQUARE) + LEAST_SCALE
    for _ in range(ROUNDS):
        moved = samples.values + (slopes @ turns[sightings.view][:, :, None])[:, :, 0]
        rest = moved - means_by_point(moved, point, count)[point]
        weight = 1 / np.maximum(np.abs(rest) / (HUBER * scale), 1)
        for view, rows in enumerate(parts):
            slope, w = slopes[rows].reshape(-1, 6), weight[rows].reshape(-1, 1)
            gram = (slope * w).T @ slope + np.diag(scale**2 * ridges[view] + 1e-30)
            turns[view] -= np.linalg.solve(gram, slope.T @ (w * rest[rows].reshape(-1, 1)))[:, 0]
    return tuple(_moved(camera, turn) for camera, turn in zip(sightings.cameras, turns, strict=True))


def _effect(camera: Camera, positions: np.ndarray) -> np.ndarray:
    """Derivative (N, 2, 6) of the pixels of positions (N, 3) by the camera's turn (radians) and displacement."""
    local = positions @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    x, y, z = local.T
    u, v, zero = x / z, y / z, np.zeros_like(z)
    fx, fy = camera.K[0, 0], camera.K[1, 1]
    horizontal = fx * np.stack([-u * v, 1 + u * u, -v, 1 / z, zero, -u / z], axis=1)
    vertical = fy * np.stack([-1 - v * v, u * v, u, zero, 1 / z, -v / z], axis=1)
    return np.stack([horizontal, vertical], axis=1)


def _moved(camera: Camera, turn: np.ndarray) -> Camera:
    """The camera after a turn (radians) and displacement, in its own axes."""
    change = np.eye(4)
    change[:3, :3] = Rotation.from_rotvec(turn[:3]).as_matrix()
    change[:3, 3] = turn[3:]
    return Camera(camera.K, change @ camera.world_to_camera, camera.width, camera.height)


def disagreement(given: Sightings, registered: Sequence[tuple[Camera, ...]]) -> np.ndarray:
    """Variance (V,) along each axis, px², of the displacements of the given cameras from the right ones.

    registered: two independent registrations. Their errors are independent as well, so that the mean product of their
    displacements has no part of them. Of these, moves of the points are taken out: cameras that are all displaced
    together see the same at points that are displaced with them.
    """
    point, view, count = given.point, given.view, len(given.points)
    number = np.bincount(point, minlength=count)[point]
    rests = [_unexplained(given, cameras) for cameras in registered]
    product = (rests[0] * rests[-1]).sum(axis=1) / (2 - 3 / number)
    sums = np.bincount(view, product, minlength=len(given.cameras))
    return sums / np.maximum(np.bincount(view, minlength=len(given.cameras)), 1)


def _unexplained(given: Sightings, cameras: tuple[Camera, ...]) -> np.ndarray:
    """Displacements (S, 2), px, of the given cameras from others, less those that moves of the points explain."""
    change, moves = np.zeros((len(given.point), 2)), np.zeros((len(given.point), 2, 3))
    for v, camera in enumerate(cameras):
        rows = given.view == v
        positions = given.points[given.point[rows]]
        change[rows] = camera.project(positions)[0] - given.cameras[v].project(positions)[0]
        moves[rows] = pixel_moves(given.cameras[v], positions)
    count = len(given.points)
    normal = sums_by_point(np.matmul(moves.transpose(0, 2, 1), moves), given.point, count)
    right = sums_by_point((moves * change[:, :, None]).sum(axis=1), given.point, count)
    normal += np.eye(3) * (1e-9 * np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-30)
    shift = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return change - (moves @ shift[given.point][:, :, None])[:, :, 0]

"""Degenerate scenes, made from a sound one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tdgbench.scenes import Camera, PointCloud, Scene, View


def with_points(scene: Scene, points: np.ndarray) -> Scene:
    """A scene with other points (N, 3), world units, all gray."""
    return replace(scene, points=PointCloud(points.astype(np.float64), np.full((len(points), 3), 0.5, np.float32)))


def with_cameras_on_a_line(scene: Scene, position: Callable[[int], float]) -> Scene:
    """A scene whose training cameras have the rotation of the first one and stand on a line, at position(index)."""
    first = scene.train[0]
    views = []
    for i, view in enumerate(scene.train):
        pose = first.camera.world_to_camera.copy()
        pose[0, 3] += position(i)
        views.append(_with_camera(view, replace(first.camera, world_to_camera=pose)))
    return replace(scene, train=views)


def shifted(scene: Scene, offset: float) -> Scene:
    """A scene moved by an offset along each axis, world units. Raises ValueError if it has no points."""
    if scene.points is None:
        raise ValueError(f"scene {scene.name} has no points to shift")
    views = []
    for view in scene.train:
        pose = view.camera.world_to_camera.copy()
        pose[:3, 3] -= pose[:3, :3] @ np.full(3, offset)
        views.append(_with_camera(view, replace(view.camera, world_to_camera=pose)))
    return replace(scene, train=views, points=PointCloud(scene.points.points + offset, scene.points.colors))


def _with_camera(view: View, camera: Camera) -> View:
    return replace(view, camera=camera)

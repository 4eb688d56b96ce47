import numpy as np
import pytest

from tdgbench.scenes import Camera
from tdgbench.scoring.metrics.depth import depth_inconsistency


def plane_depth(camera: Camera, distance: float) -> np.ndarray:
    """z of the world's plane z = distance, seen from a camera."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(camera.K).T
    world = rays @ camera.world_to_camera[:3, :3]
    return (distance - camera.center[2]) / world[..., 2]


def looking(angle: float, shift: float) -> Camera:
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[0, 3] = shift
    return Camera(np.array([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]]), pose, 64, 48)


def test_one_plane_is_consistent_between_views():
    one, other = looking(0.0, 0.0), looking(0.15, -0.3)
    a, b = plane_depth(one, 5.0), plane_depth(other, 5.0)
    assert depth_inconsistency(a, one, b, other) < 0.005  # half a pixel of a slanted plane
    assert depth_inconsistency(a * 1.1, one, b, other) == pytest.approx(0.1, abs=0.02)


def test_views_that_do_not_overlap_say_nothing():
    one, away = looking(0.0, 0.0), looking(np.pi, 0.0)
    depth = np.full((48, 64), 5.0)
    assert depth_inconsistency(depth, one, depth, away) is None
    assert depth_inconsistency(np.zeros((48, 64)), one, depth, one) is None

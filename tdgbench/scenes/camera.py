"""A pinhole camera, and its pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Camera:
    """A pinhole camera in OpenCV axes: x right, y down, z forward. Pixel centres are at integers + 1/2.

    >>> camera = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), width=64, height=48)
    >>> camera.project(np.array([[0.5, 0.25, 2.0]]))
    (array([[25. , 12.5]]), array([2.]))
    >>> camera.resized(32, 24).K.diagonal()
    array([50., 50.,  1.])
    """

    K: np.ndarray  # (3, 3) float64, px
    world_to_camera: np.ndarray  # (4, 4) float64, rigid
    width: int  # px
    height: int  # px

    @property
    def center(self) -> np.ndarray:
        """Position (3,) in world coordinates."""
        return -self.world_to_camera[:3, :3].T @ self.world_to_camera[:3, 3]

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera of the same image resampled to width × height px."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        return Camera(scale @ self.K, self.world_to_camera, width, height)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pixels (N, 2) as (x, y) and depths z (N,) in world units, of world points (N, 3)."""
        local = points @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]
        z = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            pixels = local[:, :2] / z[:, None] * self.K[[0, 1], [0, 1]] + self.K[:2, 2]
        return pixels, z

    def shows(self, points: np.ndarray) -> np.ndarray:
        """Return which of the world points (N, 3) lie in front of the camera and in its image, (N,) bool."""
        return self.holds(*self.project(points))

    def holds(self, pixels: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Return which projected points, at pixels (N, 2) and depths z (N,), lie in the image, (N,) bool."""
        x, y = pixels.T
        return (z > 0) & (x >= 0) & (y >= 0) & (x < self.width) & (y < self.height)


def pose_at(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return world to camera (4, 4) of a camera at a position (3,) with a rotation (3, 3) from the world to it."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
    return pose

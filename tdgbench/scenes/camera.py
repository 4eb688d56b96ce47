"""A pinhole camera, its pose, and the check of its numbers, which every loader calls before a camera is used."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tdgbench.scenes.errors import SceneError

MAX_PIXELS = 89_478_485  # of an image; Pillow's limit against decompression bombs (Image.MAX_IMAGE_PIXELS)
FIELD_OF_VIEW = (1.0, 179.0)  # degrees; a pinhole has less than 180, COLMAP drops less than 5.7
MAX_PIXEL_ASPECT = 4.0  # fx / fy; anamorphic lenses have 2
MAX_COORDINATE = 1e9  # world units; geocentric coordinates in metres stay below 7e6
ROTATION_TOLERANCE = 1e-2  # of R Rᵀ − I; a quaternion of length 1.001 has 0.004


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


def check_camera(camera: Camera, where: str) -> Camera:
    """Return the camera. Raises SceneError, beginning with `where`, if one of its numbers cannot be right.

    >>> camera = Camera(np.diag([50.0, 50.0, 1.0]), np.eye(4), 64, 48)
    >>> check_camera(camera, "view 1") is camera
    True
    >>> check_camera(Camera(np.diag([-50.0, 50.0, 1.0]), np.eye(4), 64, 48), "view 1")
    Traceback (most recent call last):
    tdgbench.scenes.errors.SceneError: view 1 has the focal length -50 px; it must be positive. Correct the model
    """
    K, pose = camera.K, camera.world_to_camera
    if K.shape != (3, 3) or pose.shape != (4, 4):
        raise _wrong(where, f"has K of shape {K.shape} and a pose of shape {pose.shape}", "it must be (3, 3), (4, 4)")
    check_intrinsics(camera.width, camera.height, (K[0, 0], K[1, 1]), (K[0, 2], K[1, 2]), where)
    if not np.array_equal(K, [[K[0, 0], 0, K[0, 2]], [0, K[1, 1], K[1, 2]], [0, 0, 1]]):
        raise _wrong(where, f"has K = {K.tolist()}", "only focal lengths and principal point may differ from I")
    check_pose(pose, where)
    return camera


def check_intrinsics(
    width: int, height: int, focal: tuple[float, ...], principal: tuple[float, ...], where: str
) -> None:
    """Raise SceneError unless size, focal lengths (fx, fy) and principal point (x, y), all in px, can be a camera's."""
    check_size(width, height, where)
    for length, size in zip(focal, (width, height), strict=True):
        if not (math.isfinite(length) and length > 0):
            raise _wrong(where, f"has the focal length {length:g} px", "it must be positive")
        angle = 2 * math.degrees(math.atan(size / (2 * length)))
        if not FIELD_OF_VIEW[0] <= angle <= FIELD_OF_VIEW[1] and size > 1:
            low, high = FIELD_OF_VIEW
            what = f"has the focal length {length:g} px for {size} px, a field of view of {angle:.3g}°"
            raise _wrong(where, what, f"it must be {low:g}° to {high:g}°")
    if not 1 / MAX_PIXEL_ASPECT <= focal[0] / focal[1] <= MAX_PIXEL_ASPECT:
        raise _wrong(where, f"has focal lengths of {focal[0]:g} and {focal[1]:g} px", "they must be similar")
    for center, size in zip(principal, (width, height), strict=True):
        if not -size <= center <= 2 * size:
            what = f"has its principal point at {center:g} px of {size} px"
            raise _wrong(where, what, "it must be less than an image's size outside the image")


def check_size(width: int, height: int, where: str) -> None:
    """Raise SceneError unless an image of width × height px can be held."""
    if not (width >= 1 and height >= 1 and width * height <= MAX_PIXELS):
        raise _wrong(where, f"is {width}×{height} px", f"it must have 1 to {MAX_PIXELS} pixels")


def check_pose(pose: np.ndarray, where: str) -> None:
    """Raise SceneError unless a world-to-camera matrix (3 or 4, 4) is finite, rigid and near enough to compute with."""
    rotation, translation = pose[:3, :3], pose[:3, 3]
    if not np.isfinite(pose).all():
        raise _wrong(where, "has a pose that is not finite", "")
    far = np.abs(rotation @ rotation.T - np.eye(3)).max() > ROTATION_TOLERANCE
    if far or np.linalg.det(rotation) < 0:
        raise _wrong(where, "has a pose whose 3×3 part is no rotation", "")
    if len(pose) == 4 and not np.array_equal(pose[3], [0, 0, 0, 1]):
        raise _wrong(where, f"has a pose whose last row is {pose[3].tolist()}", "it must be 0, 0, 0, 1")
    if np.abs(translation).max() > MAX_COORDINATE:
        what = f"has a pose {np.abs(translation).max():.3g} from the origin"
        raise _wrong(where, what, f"the limit is {MAX_COORDINATE:g}")


def _wrong(where: str, what: str, rule: str) -> SceneError:
    return SceneError(f"{where} {what}{'; ' if rule else ''}{rule}. Correct the model")

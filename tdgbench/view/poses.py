"""Cameras as viser gives and takes them, over a window of any shape; and the scene's cameras as frustums."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from tdgbench.present.colours import in_colour
from tdgbench.scenes import Camera
from tdgbench.scenes.camera import pose_at
from tdgbench.scenes.outliers import outlying
from tdgbench.view.cells import ViewedCell

if TYPE_CHECKING:
    import viser

ROOT = "/cameras"
TEST_COLOR, TRAIN_COLOR = (255, 150, 40), (90, 160, 255)
THUMBNAIL_WIDTH = 96  # px
MAX_PIXELS = 2**25  # of a picture; a screen of 7680 × 4320 has fewer
FOV = (1e-3, np.pi - 1e-3)  # radians; a pinhole's least and most
SIZE = 0.045  # of the cameras' mean distance from the point that they look at


class ViserPose(NamedTuple):
    """A camera of viser (`viser.CameraHandle`): OpenCV axes, the optical axis through the middle of the image."""

    wxyz: np.ndarray  # (4,) rotation from camera to world
    position: np.ndarray  # (3,) world
    fov: float  # vertical, radians


def camera_of(pose: ViserPose, width: int, height: int) -> Camera:
    """Return the pinhole camera of a pose, for an image of width × height px. `FOV` bounds its field of view.

    >>> camera = camera_of(ViserPose(np.array([1.0, 0, 0, 0]), np.array([0.0, 0, -2]), np.pi / 2), 40, 20)
    >>> camera.K.diagonal().round(6), camera.project(np.zeros((1, 3)))
    (array([10., 10.,  1.]), (array([[20., 10.]]), array([2.])))
    """
    rotation = Rotation.from_quat(np.roll(pose.wxyz, -1)).as_matrix().T
    focal = height / 2 / np.tan(np.clip(pose.fov, *FOV) / 2)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(K, pose_at(pose.position, rotation), width, height)


def picture_size(width: int, height: int, limit: int) -> tuple[int, int]:
    """Return the size of the picture for a window of width × height px: as large, but no side above the limit.

    >>> picture_size(640, 480, 1280), picture_size(1920, 1080, 1280), picture_size(1, 60_000, 1280)
    ((640, 480), (1280, 720), (1, 1280))
    """
    scale = min(1.0, limit / max(width, height), (MAX_PIXELS / width / height) ** 0.5)
    return max(1, round(scale * width)), max(1, round(scale * height))


def pose_of(camera: Camera, aspect: float) -> ViserPose:
    """Return the pose from which a window of an aspect ratio (width over height) shows all of a camera's image.

    >>> camera = Camera(np.diag([10.0, 10, 1]) + [[0, 0, 20], [0, 0, 10], [0, 0, 0]], np.eye(4), 40, 20)
    >>> [round(float(np.tan(pose_of(camera, aspect).fov / 2)), 6) for aspect in (2, 3, 1)]
    [1.0, 1.0, 2.0]
    """
    to_world = camera.world_to_camera[:3, :3].T
    horizontal, vertical = reach_of(camera)
    fov = 2 * float(np.arctan(max(vertical, horizontal / aspect)))
    return ViserPose(np.roll(Rotation.from_matrix(to_world).as_quat(), 1), camera.center, fov)


def reach_of(camera: Camera) -> tuple[float, float]:
    """Return how far a camera's image reaches from its optical axis, in x and in y, at z = 1."""
    (fx, fy), (cx, cy) = camera.K[[0, 1], [0, 1]], camera.K[:2, 2]
    return float(max(cx, camera.width - cx) / fx), float(max(cy, camera.height - cy) / fy)


def up_direction(cameras: Iterable[Camera]) -> np.ndarray:
    """Return the direction (3,) that is up in the images on average; world z if the cameras do not agree on any."""
    up = -np.mean([camera.world_to_camera[1, :3] for camera in cameras], axis=0)
    length = float(np.linalg.norm(up))
    return up / length if length > 0.1 else np.array([0.0, 0.0, 1.0])


def focus(cameras: Iterable[Camera]) -> np.ndarray:
    """Return the point (3,) nearest to the optical axes, in the least-squares sense; the orbit's centre of a capture.

    Parallel axes have none: then it is one unit in front of the cameras' mean position.
    """
    cameras = _standing(cameras)
    centers = np.stack([camera.center for camera in cameras])
    axes = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]  # (N, 3, 3) projections along the axes
    total = across.sum(axis=0)
    if np.linalg.cond(total) > 1e6:
        return centers.mean(axis=0) + axes.mean(axis=0)
    return np.linalg.solve(total, (across @ centers[:, :, None]).sum(axis=0)[:, 0])


def _standing(cameras: Iterable[Camera]) -> list[Camera]:
    """Return cameras without outlying ones."""
    cameras = list(cameras)
    return [camera for camera, is_out in zip(cameras, outlying(cameras), strict=True) if not is_out]


class Frustums:
    """The cameras of a cell in one client's scene. on_click is called with the name of a view."""

    def __init__(
        self,
        scene: viser.SceneApi,
        cell: ViewedCell,
        thumbnails: Mapping[str, np.ndarray],
        on_click: Callable[[str], None],
    ) -> None:
        self.root = scene.add_frame(ROOT, show_axes=False)  # of all cameras
        size = size_of(cell)
        self._handles = {}
        for number, (view, camera) in enumerate(cell.cameras.items()):
            aspect = camera.width / camera.height
            pose = pose_of(camera, aspect)
            handle = scene.add_camera_frustum(
                f"{ROOT}/{number}", pose.fov, aspect, scale=size, wxyz=pose.wxyz, position=pose.position,
                color=TEST_COLOR if view in cell.test else TRAIN_COLOR, thickness=1.5, thickness_units="screen",
                image=thumbnails.get(view), cast_shadow=False, receive_shadow=False,
            )  # fmt: skip
            handle.on_click(lambda _, view=view: on_click(view))  # type: ignore[misc]
            self._handles[view] = handle

    def show(self, visible: bool) -> None:
        self.root.visible = visible

    def leave_out(self, view: str) -> None:
        """Hide the camera that the viewer stands at, whose picture would cover everything."""
        for name, handle in self._handles.items():
            handle.visible = name != view


def size_of(cell: ViewedCell) -> float:
    """Return the size of the frustums in world units."""
    cameras = _standing(cell.cameras.values())
    centers = np.stack([camera.center for camera in cameras])
    return SIZE * float(np.linalg.norm(centers - focus(cameras), axis=1).mean())


def thumbnails(cell: ViewedCell) -> dict[str, np.ndarray]:
    """Return small thermal pictures (H, W, 3) uint8 of the views that have one; a click on them is easy."""
    images = {}
    for view in cell.test:
        picture = cell.pictures(view).get("thermal")
        if picture is not None:
            image = Image.fromarray(in_colour(picture))
            image.thumbnail((THUMBNAIL_WIDTH, THUMBNAIL_WIDTH))
            images[view] = np.asarray(image)
    return images

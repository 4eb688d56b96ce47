"""The scene's cameras as frustums; a click on one moves the viewer there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from tdgbench.view.cells import ViewedCell
from tdgbench.view.poses import focus, pose_of

ROOT = "/cameras"
TEST_COLOR, TRAIN_COLOR = (255, 150, 40), (90, 160, 255)
SIZE = 0.045  # of the cameras' mean distance from the point that they look at


def add_frustums(scene: viser.SceneApi, cell: ViewedCell, on_click: Callable[[str], None]) -> viser.FrameHandle:
    """Add the cameras of a cell to one client's scene; return their common frame, which shows or hides them.

    on_click: called with the name of a view.
    """
    root = scene.add_frame(ROOT, show_axes=False)
    size = size_of(cell)
    for number, (view, camera) in enumerate(cell.cameras.items()):
        aspect = camera.width / camera.height
        pose = pose_of(camera, aspect)
        handle = scene.add_camera_frustum(
            f"{ROOT}/{number}", pose.fov, aspect, scale=size, wxyz=pose.wxyz, position=pose.position,
            color=TEST_COLOR if view in cell.test else TRAIN_COLOR, thickness=1.5, thickness_units="screen",
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip
        handle.on_click(lambda _, view=view: on_click(view))  # type: ignore[misc]
    return root


def size_of(cell: ViewedCell) -> float:
    """Return the size of the frustums in world units."""
    cameras = list(cell.cameras.values())
    centers = np.stack([camera.center for camera in cameras])
    return SIZE * float(np.linalg.norm(centers - focus(cameras), axis=1).mean())

"""The scene's cameras as frustums with their pictures; a click on one moves the viewer there."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import viser
from PIL import Image

from tdgbench.view.cells import ViewedCell
from tdgbench.view.paint import as_rgb
from tdgbench.view.poses import focus, pose_of

ROOT = "/cameras"
TEST_COLOR, TRAIN_COLOR = (255, 150, 40), (90, 160, 255)
SIZE = 0.045  # of the cameras' mean distance from the point that they look at
PICTURE_WIDTH = 96  # px


class Frustums:
    """The cameras of a cell in one client's scene. on_click is called with the name of a view."""

    def __init__(
        self,
        scene: viser.SceneApi,
        cell: ViewedCell,
        thumbnails: Mapping[str, np.ndarray],
        on_click: Callable[[str], None],
    ) -> None:
        self._root = scene.add_frame(ROOT, show_axes=False)
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
        """Show or hide all cameras."""
        self._root.visible = visible

    def leave_out(self, view: str) -> None:
        """Hide the camera that the viewer stands at, whose picture would cover everything."""
        for name, handle in self._handles.items():
            handle.visible = name != view


def size_of(cell: ViewedCell) -> float:
    """Return the size of the frustums in world units."""
    cameras = list(cell.cameras.values())
    centers = np.stack([camera.center for camera in cameras])
    return SIZE * float(np.linalg.norm(centers - focus(cameras), axis=1).mean())


def thumbnails(cell: ViewedCell) -> dict[str, np.ndarray]:
    """Return small thermal pictures (H, W, 3) uint8 of the views that have one."""
    found = {}
    for view in cell.cameras:
        picture = cell.pictures(view).get("thermal")
        if picture is not None:
            image = Image.fromarray(as_rgb(picture, "inferno"))
            image.thumbnail((PICTURE_WIDTH, PICTURE_WIDTH))
            found[view] = np.asarray(image)
    return found

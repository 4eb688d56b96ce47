"""One browser: its camera, its controls, and the pictures that it is sent."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from functools import partial
from typing import NamedTuple

import numpy as np
import viser

from tdgbench.text import shortened
from tdgbench.view.cells import ViewedCell
from tdgbench.view.panel import Panel, readout
from tdgbench.view.poses import Frustums, ViserPose, focus, picture_size, pose_of
from tdgbench.view.renderer import Look, RenderedLook
from tdgbench.view.requests import Requests

JPEG_QUALITY = 80  # of coarse pictures; fine ones are PNG
MAX_CALLS = 8  # of a client at a time, of the 32 that viser runs for all
STANDS_AT = 1e-3  # distance from a view that counts as none, as a share of that to the focus


class Wanted(NamedTuple):
    """A picture that a session has requested."""

    session: Session
    look: Look
    pose: ViserPose
    width: int  # of the fine picture, px
    height: int


class Shown(NamedTuple):
    """What all sessions show. width: most pixels of a picture's width. thumbnails: of the first cell's views."""

    cells: dict[str, ViewedCell]
    thumbnails: dict[str, np.ndarray]
    width: int


class Session:
    """A connected browser: its camera, controls and pictures."""

    def __init__(self, client: viser.ClientHandle, shown: Shown, requests: Requests[Wanted]) -> None:
        self.client, self._requests, self._width = client, requests, shown.width
        self._turn = threading.RLock()  # viser calls from several threads at once
        self._free = threading.Semaphore(MAX_CALLS)
        self._parts = ExitStack()  # what is on the page
        self.attempt(partial(self.begin, shown))
        client.camera.on_update(self._callback(lambda _: self._moved()))
        client.scene.on_click()(self._callback(lambda event: self.read_at(*event.screen_pos)))

    def begin(self, shown: Shown) -> None:
        """Show cells, in the place of others, from their first view on."""
        with self._turn:
            self._parts.close()
            self._cells, self._first = shown.cells, next(iter(shown.cells.values()))
            self._focus = focus(self._first.cameras.values())
            self._frame: RenderedLook | None = None
            self._clicked: tuple[float, float] | None = None
            on_look, on_view, on_step = (self._callback(one) for one in (self.refresh, self.go_to, self.step))
            self.panel = Panel(self.client.gui, shown.cells, on_look, on_view, on_step)
            self._view, self._aspect = self.panel.views[0], 0.0  # the last view that it was sent to, in which window
            self._left = self._view  # the one before
            self._frustums = Frustums(self.client.scene, self._first, shown.thumbnails, on_view)
            self.panel.cameras.on_update(self._callback(lambda _: self._frustums.show(self.panel.cameras.value)))
            self._parts.callback(self.panel.remove)
            self._parts.callback(self._frustums.root.remove)
            self.go_to(self._view)
            self.refresh()

    def attempt(self, action: Callable[[], object]) -> None:
        """Do something for this client. An error is shown on its page, and no other client notices."""
        try:
            action()
        except (Exception, SystemExit) as error:  # a method of the user may raise anything
            with suppress(Exception), self._turn:  # there may be no panel yet
                self.panel.show_value(shortened(f"{type(error).__name__}: {error}"))

    def _callback(self, action: Callable[..., None]) -> Callable[..., None]:
        """Return a callback for viser, whose threads print errors.

        It does nothing while `MAX_CALLS` wait: they will read the same camera and controls.
        """

        def call(*arguments: object) -> None:
            if self._free.acquire(blocking=False):
                self.attempt(partial(action, *arguments))
                self._free.release()

        return call

    def step(self, count: int) -> None:
        """Move the camera that many views on from the last one that it was sent to, in a circle."""
        with self._turn:
            self.go_to(self.panel.views[(self.panel.views.index(self._view) + count) % len(self.panel.views)])

    def go_to(self, view: str) -> None:
        """Move the camera to that of a view."""
        with self._turn:
            if view != self._view:
                self._left = self._view
            camera = self.client.camera
            pose = pose_of(self._first.cameras[view], camera.aspect)
            forward = self._first.cameras[view].world_to_camera[2, :3]
            distance = float(forward @ (self._focus - pose.position))
            with self.client.atomic():
                camera.fov = pose.fov
                camera.position = pose.position
                camera.wxyz = pose.wxyz
                if distance > 0:  # else the distance to the orbit's centre stays
                    camera.look_at = pose.position + distance * forward
            self._view, self._aspect = view, camera.aspect
            self.panel.show_view(view)
            self._frustums.leave_out(view)
            self._requests.moved(self.client.client_id, self._wanted())

    def read_at(self, x: float, y: float) -> None:
        """Show the values at a place of the picture; x and y are shares of its width and height."""
        self._clicked = (x, y)
        if self._frame is not None:
            self.panel.show_value(readout(self._frame.at(x, y), self._cells, self._frame.look.quantity))

    def show(self, frame: RenderedLook, is_fine: bool) -> None:
        send = self.client.scene.set_background_image
        send(frame.picture, "png" if is_fine else "jpeg", jpeg_quality=JPEG_QUALITY)
        self.client.flush()
        self._frame = frame
        if is_fine:
            self.panel.describe(frame)
            if self._clicked is not None:
                self.read_at(*self._clicked)

    def _moved(self) -> None:
        camera = self.client.camera
        with self._turn:
            if self._stands_at(self._view):
                if camera.aspect != self._aspect:  # the window has got another shape
                    self._aspect = camera.aspect
                    camera.fov = pose_of(self._first.cameras[self._view], camera.aspect).fov
            elif self._stands_at(self._left):  # viser sends no pose that the page has last reported, even if outdated
                self.go_to(self._view)
        self._requests.moved(self.client.client_id, self._wanted())

    def _stands_at(self, view: str) -> bool:
        center = self._first.cameras[view].center
        away = np.linalg.norm(self.client.camera.position - center)
        return bool(away < STANDS_AT * np.linalg.norm(self._focus - center))

    def refresh(self) -> None:
        self._requests.changed(self.client.client_id, self._wanted())

    def _wanted(self) -> Wanted:
        camera = self.client.camera
        width, height = picture_size(camera.image_width, camera.image_height, self._width)
        return Wanted(self, self.panel.look(), ViserPose(camera.wxyz, camera.position, camera.fov), width, height)

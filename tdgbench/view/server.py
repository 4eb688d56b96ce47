"""The viewer's server: one thread renders for all browsers, in turns."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
import warnings
from collections.abc import Iterator
from functools import partial

import rich
import viser

from tdgbench.view.cells import ViewedCell
from tdgbench.view.guard import guarded_server
from tdgbench.view.poses import camera_of, thumbnails, up_direction
from tdgbench.view.renderer import Renderer
from tdgbench.view.requests import RenderJob, Requests
from tdgbench.view.session import Session, Shown, Wanted

FIRST_PORT, LAST_PORT = 8080, 8180  # where a free one is looked for
TARGET_SECONDS = 1 / 24  # per picture of a moving camera
SMALLEST = 0.05  # of the full size; radiance fields need it
LARGEST_STEP = 1.5  # by which the size changes from one picture to the next
MIN_SIDE = 16  # px


class Viewer:
    """The viewer: it shows cells of one scene to every browser that connects.

    width: most pixels of a picture's width.
    """

    def __init__(self, server: viser.ViserServer, cells: dict[str, ViewedCell], width: int) -> None:
        first = next(iter(cells.values()))
        self._shown = Shown(cells, thumbnails(first), width)
        self._server, self._requests = server, Requests[Wanted]()
        self._sessions: dict[int, Session] = {}  # by client
        self._turn = threading.Lock()  # of the cells
        self._renderer, self._pace = Renderer(cells), Pace()
        self._ended = threading.Event()
        self._worker = threading.Thread(target=self._work, name="viewer", daemon=True)
        self._renderer.prepare()
        server.scene.set_up_direction(up_direction(first.cameras.values()))
        server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False, control_width="large")
        server.gui.main_panel.dock_right()
        server.on_client_connect(self._welcome)
        server.on_client_disconnect(self._forget)
        self._worker.start()

    def wait(self, seconds: float | None = None) -> None:
        """Serve for some seconds or until `close`."""
        self._ended.wait(seconds)

    def replace(self, cells: dict[str, ViewedCell]) -> None:
        """Show newer states of the cells, or others of the same names, whose pages begin anew."""
        new, old = next(iter(cells.values())), next(iter(self._shown.cells.values()))
        with self._turn:
            self._shown.cells.update(cells)
            self._renderer.forget()
        if new.record.title != old.record.title:
            self._shown = self._shown._replace(thumbnails=thumbnails(new))
            self._server.scene.set_up_direction(up_direction(new.cameras.values()))
        for session in list(self._sessions.values()):
            is_same = new.record.title == old.record.title
            session.attempt(session.refresh if is_same else partial(session.begin, self._shown))

    def close(self) -> None:
        self._requests.close()
        self._worker.join()
        self._ended.set()

    def _welcome(self, client: viser.ClientHandle) -> None:
        self._sessions[client.client_id] = Session(client, self._shown, self._requests)
        if client.client_id not in self._server.get_clients():  # it has left meanwhile
            self._forget(client)

    def _forget(self, client: viser.ClientHandle) -> None:
        self._sessions.pop(client.client_id, None)
        self._requests.forget(client.client_id)

    def _work(self) -> None:
        for request in iter(self._requests.next, None):
            if request.client in self._server.get_clients():
                request.wanted.session.attempt(partial(self._render, request))
            else:
                self._requests.forget(request.client)

    def _render(self, request: RenderJob[Wanted]) -> None:
        wanted, start = request.wanted, time.perf_counter()
        size = (wanted.width, wanted.height)
        size = size if request.is_fine else self._pace.coarse(*size)
        with self._turn:
            if not self._renderer.has(wanted.look.cell, wanted.look.quantity):  # of cells shown before
                return
            frame = self._renderer.render(wanted.look, camera_of(wanted.pose, *size))
        if request.is_fine and not self._requests.is_newest(request):
            return
        wanted.session.show(frame, request.is_fine)
        if not request.is_fine:
            self._pace.took(time.perf_counter() - start)


class Pace:
    """Scale of the pictures of a moving camera, from the times that earlier ones took."""

    def __init__(self) -> None:
        self.scale = 0.5

    def coarse(self, width: int, height: int) -> tuple[int, int]:
        """Return the size in px of the next picture in motion. width, height: of the full picture."""
        return max(MIN_SIDE, round(width * self.scale)), max(MIN_SIDE, round(height * self.scale))

    def took(self, seconds: float) -> None:
        """Learn from the time of a picture in motion.

        >>> pace = Pace()
        >>> pace.took(4 * TARGET_SECONDS)
        >>> round(pace.scale, 3)
        0.333
        """
        change = (TARGET_SECONDS / max(seconds, 1e-6)) ** 0.5  # time grows with the number of pixels
        self.scale = min(1.0, max(SMALLEST, self.scale * min(LARGEST_STEP, max(1 / LARGEST_STEP, change))))


@contextlib.contextmanager
def serving(host: str, port: int | None) -> Iterator[viser.ViserServer]:
    """Run a server of viser that prints nothing. port: None for the first free one from 8080 on.

    Raises OSError, naming the address, if it cannot be used: viser would try other ports, and wait forever for a host
    that is not this machine. Raises ValueError if this version of viser cannot be guarded.
    """
    warnings.filterwarnings("ignore", "Queued a .* on a closed connection", UserWarning)  # pages close at any time
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        server = guarded_server(host, free_port(host, port))
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = quiet


def free_port(host: str, port: int | None) -> int:
    """Return the port, or the first free one from 8080 on. Raises OSError if it cannot be used."""
    for candidate in range(FIRST_PORT, LAST_PORT + 1) if port is None else [port]:
        try:
            with socket.create_server((host, candidate)):
                return candidate
        except OSError as error:
            failure = error
    raise OSError(f"{host}:{port or FIRST_PORT} cannot be served: {failure.strerror}; choose --host and --port")

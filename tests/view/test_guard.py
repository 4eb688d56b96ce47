"""The served viewer and clients that are no pages of its own: refused or disconnected, while others are served."""

from __future__ import annotations

import contextlib
import http.client
import socket
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from tdgbench.view.cells import open_cells
from tests.helpers.waiting import waited

viser = pytest.importorskip("viser")
import msgspec  # noqa: E402 # of viser, as the next two
import zstandard  # noqa: E402
from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from tdgbench.view import guard  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:Queued a")  # for a page that has closed; `serving` ignores it, too
NAN, INF = float("nan"), float("inf")
CAMERA = {
    "wxyz": [1, 0, 0, 0], "position": [0.5, -3, 1], "fov": 1.0, "near": 0.01, "far": 1000, "image_height": 48,
    "image_width": 64, "look_at": [0, 0, 0], "up_direction": [0, 0, 1],
}  # fmt: skip
CLICK = {
    "type": "ScenePointerMessage", "event_type": "click", "ray_origin": [0, 0, 0], "ray_direction": [0, 0, 1],
    "screen_pos": [[0.5, 0.5]], "modifier": None,
}  # fmt: skip


class Page:
    """What a page of viser does: it connects, sends messages, and reads the answers."""

    def __init__(self, port: int, host: str = "127.0.0.1", origin: str | None = "") -> None:
        address = f"{host}:{port}"
        self.socket = connect(
            f"ws://{address}", sock=socket.create_connection(("127.0.0.1", port)), compression=None, max_size=None,
            close_timeout=1, subprotocols=[f"viser-v{viser.__version__}"],
            origin=f"http://{address}" if origin == "" else origin,
        )  # fmt: skip
        self.seen: list[dict] = []  # messages, oldest first

    def send(self, **message) -> None:
        self.socket.send(msgspec.msgpack.encode(message))

    def move(self, **camera) -> None:
        self.send(type="ViewerCameraMessage", **{**CAMERA, **camera})

    def choose(self, label: str, value: object) -> None:
        """Set a control of the panel."""
        uuid = next(m["uuid"] for m in self.seen if m.get("props", {}).get("label") == label)
        self.send(type="GuiUpdateMessage", uuid=uuid, updates={"value": value})

    def read(self, seconds: float) -> None:
        """Read what comes within some seconds, or the next message."""
        with contextlib.suppress(TimeoutError):
            frame = self.socket.recv(timeout=seconds)
            size = int.from_bytes(frame[8:16], "little")
            inner = zstandard.ZstdDecompressor().decompress(frame[16 : 16 + size])
            self.seen += msgspec.msgpack.decode(inner)["messages"]

    def is_told(self, text: str, seconds: float = 30) -> bool:
        """Whether a text comes, such as in the readout."""
        return self._sees(lambda message: text in str(message.get("updates")), seconds)

    def is_served(self, seconds: float = 30) -> bool:
        """Whether a picture comes of a camera that nobody has moved to yet."""
        self.seen = [message for message in self.seen if message.get("rgb_data") is None]
        self.move(position=np.random.default_rng().uniform(1, 2, 3).tolist())
        return self._sees(lambda message: message.get("rgb_data") is not None, seconds)

    def _sees(self, is_it: Callable[[dict], bool], seconds: float) -> bool:
        """Whether such a message comes."""
        end = time.monotonic() + seconds
        while not any(map(is_it, self.seen)):
            if time.monotonic() > end:
                return False
            self.read(0.2)
        return True

    def is_closed(self, seconds: float = 10) -> bool:
        """Whether the server ends the connection."""
        end = time.monotonic() + seconds
        try:
            while time.monotonic() < end:
                self.read(0.2)
        except ConnectionClosed:
            return True
        return False


class Served(NamedTuple):
    """A running viewer and the pages that are open."""

    server: Any
    viewer: Any
    pages: list[Page]

    @property
    def port(self) -> int:
        return self.server.get_port()

    def page(self, *arguments, **options) -> Page:
        self.pages.append(Page(self.port, *arguments, **options))
        return self.pages[-1]

    def close(self, keep: int = 0) -> None:
        """Close all pages but the first ones."""
        while len(self.pages) > keep:
            self.pages.pop().socket.close()


@contextlib.contextmanager
def served(cells, host: str = "127.0.0.1") -> Iterator[Served]:
    from tdgbench.view.server import Viewer, serving

    with serving(host, 0) as server:
        viewer = Served(server, Viewer(server, cells, 64), [])
        try:
            yield viewer
        finally:
            viewer.close()
            viewer.viewer.close()


@pytest.fixture(scope="module")
def cells(tdg_folder, msmg_folder):
    return open_cells([tdg_folder, msmg_folder])


@pytest.fixture(scope="module")
def open_viewer(cells) -> Iterator[Served]:
    with served(cells) as viewer:
        yield viewer


@pytest.fixture
def viewer(open_viewer, capfd, caplog) -> Iterator[Served]:
    """The viewer, which says nothing on the terminal and serves a page after all that the test does."""
    yield open_viewer
    open_viewer.close()
    assert open_viewer.page().is_served()
    open_viewer.close()
    assert capfd.readouterr() == ("", "") and caplog.get_records("call") == []


def status_of(port: int, **headers: str) -> int:
    """The HTTP status of the page."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.putrequest("GET", "/", skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    with contextlib.closing(connection):
        return connection.getresponse().status


def test_pages_of_other_sites_are_refused(viewer):
    """Also those of a name that an attacker's DNS leads here."""
    port = viewer.port
    for host in ("127.0.0.1", "localhost", "[::1]"):
        assert status_of(port, Host=f"{host}:{port}") == 200
        assert viewer.page(host).is_served()
    for host in ("rebound.example", "192.168.0.2", "[::2]", "127.0.0.1.example", "a@127.0.0.1", "127.0.0.1:1", ""):
        assert status_of(port, Host=f"{host}:{port}") == 403
    assert status_of(port, Host="127.0.0.1") == status_of(port) == 403
    assert status_of(port, Host=f"127.0.0.1:{port}", Origin="http://rebound.example") == 403
    own = f"http://127.0.0.1:{port}"
    for origin in ("http://rebound.example", "null", own.replace("http", "https"), f"{own}0", f"{own}.x", own[:-2]):
        with pytest.raises(InvalidStatus, match="403"):
            viewer.page(origin=origin)
    with pytest.raises(InvalidStatus, match="403"):
        viewer.page("rebound.example")
    assert viewer.page(origin=None).is_served()  # a program on this machine
    assert viewer.page(origin=f"http://localhost:{port}").is_served()


def test_other_machines_reach_a_viewer_that_lets_them_in_by_its_address(cells):
    with served(cells, "0.0.0.0") as running:
        port = running.port
        for host in ("127.0.0.1", "localhost", "192.168.0.2", "[fe80::2]", socket.gethostname()):
            assert status_of(port, Host=f"{host}:{port}") == 200
        assert running.page("192.168.0.2").is_served()
        assert status_of(port, Host=f"rebound.example:{port}") == status_of(port, Host="192.168.0.2") == 403
        other = f"http://192.168.0.3:{port}"
        for host, origin in (("rebound.example", ""), ("192.168.0.2", other), ("192.168.0.2", "null")):
            with pytest.raises(InvalidStatus, match="403"):
                running.page(host, origin=origin)


@pytest.mark.parametrize("kind", ["ShareUrlRequest", "ShareUrlDisconnect"])
def test_no_message_opens_a_tunnel(viewer, monkeypatch, kind):
    asked = []
    monkeypatch.setattr(viewer.server, "request_share_url", lambda: asked.append("tunnel"))
    monkeypatch.setattr(viewer.server, "disconnect_share_url", lambda: asked.append("no tunnel"))
    page = viewer.page()
    assert page.is_served()
    page.send(type=kind)
    assert page.is_closed() and asked == []


def test_only_messages_of_the_viewer_s_page_are_read():
    from viser._messages import Message

    for kind in {one.__name__ for one in Message.get_subclasses()} - {
        "ViewerCameraMessage", "GuiUpdateMessage", "SceneNodeClickMessage", "ScenePointerMessage"
    }:  # fmt: skip
        with pytest.raises(msgspec.ValidationError, match=kind):
            guard.MESSAGES.decode(msgspec.msgpack.encode({"type": kind}))


def test_no_client_reaches_another(viewer):
    """What viser passes on to all others."""
    page, other = viewer.page(), viewer.page()
    assert page.is_served() and other.is_served()
    page.send(type="GuiFormDirtyMessage", uuid="a")
    assert page.is_closed()
    other.read(0.5)
    assert not any("Form" in message["type"] for message in other.seen)


def message(**content: object) -> bytes:
    return msgspec.msgpack.encode(content)


def camera(**changes: object) -> bytes:
    return message(type="ViewerCameraMessage", **{**CAMERA, **changes})


def choice(value: object) -> bytes:
    return message(type="GuiUpdateMessage", uuid="a", updates={"value": value})


def click(place: object) -> bytes:
    return message(**{**CLICK, "screen_pos": [place]})


REFUSED = {
    "nothing": b"", "truncated": camera()[:-9], "a list": b"\x91\x01", "nested": b"\x91" * 60_000, "no type": b"\x80",
    "unknown": message(type="Unknown"), "type no text": message(type=["a"]),
    "lacking": message(type="ViewerCameraMessage"),
    "property": message(type="GuiUpdateMessage", uuid="a", updates={"update_cb": [1]}),
    **{str(changes): camera(**changes) for changes in (
        {"wxyz": [NAN, 0, 0, 1]}, {"wxyz": [1e300, 0, 0, 0]}, {"wxyz": [1, 0, 0]}, {"wxyz": "1000"},
        {"position": [NAN, 0, 0]}, {"position": [INF, 0, 0]}, {"position": [1e10, 0, 0]}, {"position": [0, 0]},
        {"image_width": -5}, {"image_width": 2**63}, {"image_height": "48"}, {"image_height": 60_000_000},
        {"fov": NAN}, {"fov": INF}, {"fov": None}, {"up_direction": [NAN, 0, 1]}, {"look_at": [INF, 0, 0]},
        {"look_at": [1e200, 0, 0]},
    )},
    **{f"choice {value}": choice(value) for value in (None, {}, [], [1], [1, 2, 3], [[1], 2], ["a", "b"])},
    **{f"click {place}": click(place) for place in ([NAN, 0.5], [INF, 0], [1e300, 0], [0.5], None)},
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_a_message_that_is_malformed_is_refused(what):
    with pytest.raises((msgspec.ValidationError, msgspec.DecodeError)):
        guard.MESSAGES.decode(REFUSED[what])


FRAMES = {
    "text": "text", "large": bytes(40 * 1024 * 1024), "nested": REFUSED["nested"], "truncated": REFUSED["truncated"],
    "excess": message(**CLICK, excluded_self_client=1),
    "long": message(type="GuiUpdateMessage", uuid="a" * 10**6, updates={"value": 1}),
}  # fmt: skip


@pytest.mark.parametrize("what", FRAMES)
def test_a_malformed_frame_ends_its_connection_alone(viewer, what):
    page, other = viewer.page(), viewer.page()
    assert page.is_served() and other.is_served()
    with contextlib.suppress(ConnectionClosed):  # a large frame is refused while it is sent
        page.socket.send(FRAMES[what])
    assert page.is_closed() and other.is_served()


CAMERAS = [
    {"wxyz": [0, 0, 0, 0]}, {"image_width": 0}, {"image_height": 0}, {"image_width": 1, "image_height": 60_000},
    {"image_width": 60_000, "image_height": 1}, {"image_width": 60_000, "image_height": 60_000},
    {"fov": 0}, {"fov": -1}, {"fov": np.pi}, {"fov": 7}, {"fov": 1e-300}, {"near": "a"}, {"near": NAN}, {"far": INF},
    {"up_direction": [0, 0, 0]}, {"up_direction": [1e9, 1e-9, 0]}, {"look_at": CAMERA["position"]},
    {"position": [1e9, -1e9, 1e9]}, {"position": [1e9, 0, 0], "look_at": [1e9 - 1e-7, 0, 0]},
]  # fmt: skip


def test_no_camera_harms_others(viewer):
    other = viewer.page()
    assert other.is_served()
    for changes in CAMERAS:
        for is_first in (True, False):  # the first one makes it a client
            page = viewer.page()
            with contextlib.suppress(ConnectionClosed):
                assert is_first or page.is_served()
                page.move(**changes)
                if not is_first:
                    page.choose("", "next →")
                page.read(0.1)
        assert other.is_served(), changes
        viewer.close(keep=1)


def test_a_minimized_window_is_no_reason_to_disconnect(viewer):
    page = viewer.page()
    page.move(image_width=0, image_height=0)
    assert page.is_served()


@pytest.mark.parametrize(
    ("label", "values"),
    [
        ("Cell", ["nobody", "", 7, [1, 2]]),
        ("Beside", ["nobody", True]),
        ("Show", ["nothing", "../.."]),
        ("Colours", ["nothing", 1e300]),
        ("Divide", [1000, -5, 2**62, "many", NAN, [1, 2]]),
        ("Range, %", [[90, 10], [-900, 900], "12", 5, [NAN, 1]]),
        ("Guesses in blue", ["yes", 7]),
        ("Cameras", ["no"]),
        ("View", ["nowhere", 5, "x" * 60_000]),
    ],
)
def test_no_choice_harms_anyone(viewer, label, values):
    other = viewer.page()
    for value in values:
        page = viewer.page()
        assert page.is_served()
        with contextlib.suppress(ConnectionClosed):
            page.choose(label, value)
            assert page.is_served()
    assert other.is_served()


def test_an_error_of_the_rendering_is_shown_to_its_client_alone(viewer, monkeypatch):
    page, other = viewer.page(), viewer.page()
    assert page.is_served() and other.is_served()
    renderer = viewer.viewer._renderer
    render = type(renderer).render

    def broken(look, camera):
        if look.quantity == "depth":
            raise RuntimeError("no memory")
        return render(renderer, look, camera)

    monkeypatch.setattr(renderer, "render", broken)
    page.choose("Show", "depth")
    assert page.is_told("RuntimeError: no memory") and other.is_served()
    page.choose("Show", "thermal")
    assert page.is_served() and not other.is_told("no memory", 0.5)


def test_an_error_of_a_control_is_shown_to_its_client(viewer):
    page = viewer.page()
    assert page.is_served()
    page.choose("Range, %", "123")  # viser makes (1, 2, 3) of it
    assert page.is_told("ValueError: ")
    page.choose("Range, %", [10, 90])
    assert page.is_served()


def test_a_page_that_leaves_at_once_is_forgotten(viewer, monkeypatch):
    from tdgbench.view import server

    session, welcomed = server.Session, []

    def late(client, *rest):
        waited(lambda: client.client_id not in viewer.server.get_clients(), 30, "the page leaves")
        welcomed.append(client)
        return session(client, *rest)

    monkeypatch.setattr(server, "Session", late)
    viewer.page().move()
    waited(viewer.server.get_clients, 30, "the page connects")
    viewer.close()
    waited(lambda: welcomed, 30, "its session begins")
    time.sleep(0.3)
    waited(lambda: not viewer.viewer._sessions and not viewer.viewer._requests._pending, 30, "it is forgotten")


def test_more_pages_than_that_are_refused(viewer):
    for _ in range(guard.MAX_CLIENTS):
        viewer.page()
    with pytest.raises(InvalidStatus, match="503"):
        viewer.page()
    viewer.close()
    waited(lambda: status_of(viewer.port, Host=f"127.0.0.1:{viewer.port}") == 200, 30, "it serves again")


def test_a_flood_of_messages_keeps_nobody_waiting(viewer):
    """Each choice of a view reads and sends its pictures."""
    flood, other = viewer.page(), viewer.page()
    assert flood.is_served() and other.is_served()
    views = next(m["props"]["options"] for m in flood.seen if m.get("props", {}).get("label") == "View")
    flood.socket.socket.settimeout(0.2)  # what the server does not read stays here
    with contextlib.suppress(TimeoutError, ConnectionClosed, OSError):
        for number in range(20_000):
            flood.choose("View", views[number % len(views)])
    assert other.is_served(10)
    assert viewer.server._thread_executor._work_queue.qsize() < 100


def test_a_viser_that_starts_its_server_in_another_way_serves_nobody(monkeypatch):
    from tdgbench.view.server import serving

    serve = "websockets.asyncio.server.serve"
    import websockets.asyncio.server

    original = websockets.asyncio.server.serve
    monkeypatch.setattr("viser.infra._infra.websockets", SimpleNamespace(
        asyncio=SimpleNamespace(server=SimpleNamespace(serve=original)), exceptions=websockets.exceptions,
        datastructures=websockets.datastructures,
    ))  # fmt: skip
    with pytest.raises(ValueError, match=f"viser {viser.__version__}"), serving("127.0.0.1", 0):
        pytest.fail(serve)
    assert websockets.asyncio.server.serve is original

"""Who may connect to the viewer, and what it reads from them: messages that its own page sends, with usable numbers."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import math
import socket
import threading
from http import HTTPStatus
from typing import Annotated, Any, Literal

import msgspec
import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from tdgbench.scenes.camera import MAX_COORDINATE

MAX_CLIENTS = 64
MAX_FRAME = 2**16  # bytes; a page's messages have some 300
PAUSE = 0.01  # seconds from one message of a client to the next; a page sends a camera every 20 ms at most
LOCAL = {"localhost", "127.0.0.1", "[::1]"}
_patching = threading.Lock()

Number = Annotated[float, msgspec.Meta(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]  # NaN is not between them
Vector = tuple[Number, Number, Number]
Side = Annotated[int, msgspec.Meta(ge=0, le=2**16)]  # px


class ViewerCameraMessage(msgspec.Struct, tag_field="type", tag=True):
    """A page's camera; as the other messages, under viser's name and with viser's fields."""

    wxyz: tuple[Number, Number, Number, Number]
    position: Vector
    fov: Number
    image_height: Side
    image_width: Side
    look_at: Vector
    up_direction: Vector

    def is_pose(self) -> bool:
        """Return whether it has pixels, which a minimized window lacks, and a direction."""
        lengths = math.hypot(*self.wxyz), math.hypot(*self.up_direction), math.dist(self.look_at, self.position)
        return min(lengths) > 1e-9 and min(self.image_width, self.image_height) > 0


class _Value(msgspec.Struct, forbid_unknown_fields=True):
    value: bool | float | str | tuple[float, float]  # with `Number`, this union crashes msgspec 0.22 in gc.collect()


class GuiUpdateMessage(msgspec.Struct, tag_field="type", tag=True):
    """A new value of a control, and of nothing else of it."""

    uuid: str
    updates: _Value


class SceneNodeClickMessage(msgspec.Struct, tag_field="type", tag=True):
    """A click on a camera of the scene."""

    name: str
    ray_origin: Vector
    ray_direction: Vector
    screen_pos: tuple[Number, Number]


class ScenePointerMessage(msgspec.Struct, tag_field="type", tag=True):
    """A click on the picture."""

    event_type: Literal["click"]
    ray_origin: Vector
    ray_direction: Vector
    screen_pos: tuple[tuple[Number, Number]]


MESSAGES = msgspec.msgpack.Decoder(ViewerCameraMessage | GuiUpdateMessage | SceneNodeClickMessage | ScenePointerMessage)


class Addresses:
    """The addresses of a server in Host headers and origins: no foreign name, which a foreign DNS may lead here.

    >>> [Addresses("127.0.0.1").has(one, 8080) for one in ("localhost:8080", "localhost:80", "a.example:8080")]
    [True, False, False]
    >>> [Addresses("0.0.0.0").has(one, 8080) for one in ("192.168.0.2:8080", "a.example:8080")]
    [True, False]
    """

    def __init__(self, host: str) -> None:
        self._names = {*LOCAL, host.lower()}
        self.is_local = host == "localhost" or (is_ip(host) and ipaddress.ip_address(host).is_loopback)
        if not self.is_local:
            self._names |= {socket.gethostname().lower(), socket.getfqdn().lower()}

    def has(self, address: str, port: int) -> bool:
        """Return whether it is one of the server's, which has that port."""
        name = address.lower().removesuffix(f":{port}")
        if name == address.lower() and port != 80:  # browsers leave out 80
            return False
        return name in self._names or (not self.is_local and is_ip(name.strip("[]")))

    def refusal(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the answer to a request that is not served, None to others. Programs send no origin, browsers do."""
        port: int = connection.local_address[1]
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        sites = [origin.removeprefix("http://") for origin in origins if origin.startswith("http://")]
        is_own = len(hosts) == 1 and len(sites) == len(origins) and all(self.has(one, port) for one in hosts + sites)
        if not is_own or not (self.is_local or set(sites) <= set(hosts)):
            text = f"tdgbench view: this is none of its addresses, such as http://127.0.0.1:{port}\n"
            return connection.respond(HTTPStatus.FORBIDDEN, text)
        if len(connection.server.connections) >= MAX_CLIENTS:
            return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, f"{MAX_CLIENTS} pages are open; close some\n")
        return None


def is_ip(name: str) -> bool:
    try:
        return bool(ipaddress.ip_address(name))
    except ValueError:
        return False


class GuardedConnection(ServerConnection):
    """A connection that hands on the messages of `MESSAGES` alone; an error ends it, and no other."""

    async def recv(self, decode: bool | None = None) -> Any:
        while True:
            await asyncio.sleep(PAUSE)  # a flood waits in the client's socket, not in viser's queue of callbacks
            frame = await super().recv(decode)
            message = MESSAGES.decode(frame)  # type: ignore[arg-type] # text is an error, too
            if not isinstance(message, ViewerCameraMessage) or message.is_pose():
                return frame


def guarded_server(host: str, port: int) -> viser.ViserServer:
    """Start a server of viser behind these checks.

    viser takes no options for them, but starts a server of websockets in a thread before its constructor returns, and
    that one does. Raises ValueError if it is a viser that does otherwise, and unguarded.
    """
    guarded, addresses = threading.Event(), Addresses(host)

    def serve(handler: Any, *where: Any, **options: Any) -> Any:
        if not str(handler.__module__).startswith("viser.") or "process_request" not in options:
            return original(handler, *where, **options)
        page = options["process_request"]
        options["process_request"] = lambda *call: addresses.refusal(*call) or page(*call)
        options |= {"max_size": MAX_FRAME, "create_connection": GuardedConnection}
        # No traceback of what clients send reaches the terminal: of its connection, and of its tasks in viser's thread.
        options["logger"] = logging.Logger("tdgbench.view", logging.CRITICAL + 1)
        asyncio.get_running_loop().set_exception_handler(lambda *_: None)
        guarded.set()
        return original(handler, *where, **options)

    with _patching:
        original = websockets.asyncio.server.serve
        websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
        try:
            server = viser.ViserServer(host=host, port=port, label="tdgbench", verbose=False)
        finally:
            websockets.asyncio.server.serve = original  # type: ignore[misc]
    handlers = getattr(server._websock_server, "_incoming_handlers", None)
    if not guarded.is_set() or handlers is None:
        server.stop()
        raise ValueError(f"viser {viser.__version__} cannot be served safely; pip install viser==1.1.1")
    handlers.clear()  # what acts on all clients or beyond them, such as ShareUrlRequest; each client has its own
    return server

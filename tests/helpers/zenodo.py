"""A server on this machine that speaks the part of Zenodo's API which tdgbench uses, with faults on demand."""

from __future__ import annotations

import hashlib
import json
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import NamedTuple

STEP = 10_000  # bytes that are sent at once


class Fault(NamedTuple):
    """What goes wrong with one answer.

    status: instead of the content. cut: bytes after which the connection ends, though the whole length was announced.
    ranges: False ignores the header Range. length: False announces none. first: added to where an answer to the header
    Range says that it begins. seconds: wait after each 10 000 bytes. extra: bytes appended to the content.
    """

    status: int | None = None
    cut: int | None = None
    ranges: bool = True
    length: bool = True
    first: int = 0
    seconds: float = 0.0
    extra: bytes = b""


class Zenodo:
    """The server. `files` and `sums` are what the API lists; `faults` are used up one per request for a file.

    requests: (name of the file, header Range or "") of each request for a file, in order. listings: number of requests
    for the list of files.
    """

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files
        self.sums = {name: hashlib.md5(content).hexdigest() for name, content in files.items()}
        self.faults: dict[str, list[Fault]] = {}
        self.listing: bytes | None = None  # instead of the real one
        self.requests: list[tuple[str, str]] = []
        self.listings = 0
        self.address = ""

    def record(self) -> bytes:
        """The API's answer for the record."""
        if self.listing is not None:
            return self.listing
        files = [
            {
                "key": name,
                "size": len(content),
                "checksum": f"md5:{self.sums[name]}",
                "links": {"self": f"{self.address}/api/records/1/files/{name}/content"},
            }
            for name, content in self.files.items()
        ]
        return json.dumps({"id": 1, "files": files, "metadata": {"license": {"id": "cc-by-4.0"}}}).encode()

    def fault(self, name: str) -> Fault:
        return self.faults[name].pop(0) if self.faults.get(name) else Fault()


@contextmanager
def zenodo(files: dict[str, bytes]) -> Iterator[Zenodo]:
    """A running server."""
    one = Zenodo(files)

    class Handler(_Handler):
        server_state = one

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    one.address = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}, daemon=True)
    thread.start()
    try:
        yield one
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    server_state: Zenodo

    def do_GET(self) -> None:
        state = self.server_state
        if match := re.fullmatch("/api/records/[0-9]+/files/(.+)/content", self.path):
            name, asked = match[1], self.headers.get("Range", "")
            state.requests.append((name, asked))
            self._file(name, asked, state.fault(name))
        elif re.fullmatch("/api/records/[0-9]+", self.path):
            state.listings += 1
            self._content(state.record(), Fault() if "" not in state.faults else state.fault(""), "")
        else:
            self.send_error(404)

    def _file(self, name: str, asked: str, fault: Fault) -> None:
        if name not in self.server_state.files:
            self.send_error(404)
        else:
            self._content(self.server_state.files[name] + fault.extra, fault, asked)

    def _content(self, content: bytes, fault: Fault, asked: str) -> None:
        first = int(re.fullmatch("bytes=([0-9]+)-", asked)[1]) if asked and fault.ranges else 0
        if fault.status is not None:
            self.send_response(fault.status)
            body = b"an error"
        elif first >= len(content) > 0:
            self.send_response(416)
            body = b""
        elif first:
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {first + fault.first}-{len(content) - 1}/{len(content)}")
            body = content[first:]
        else:
            self.send_response(200)
            body = content
        if fault.length:
            self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        sent = body if fault.cut is None else body[: fault.cut]
        try:
            for start in range(0, len(sent), STEP):
                self.wfile.write(sent[start : start + STEP])
                if fault.seconds:
                    time.sleep(fault.seconds)
            if fault.cut is not None:
                self.connection.shutdown(socket.SHUT_RDWR)
        except OSError:  # the client has gone
            self.close_connection = True

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""

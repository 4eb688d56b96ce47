"""Headless Chromium over its DevTools protocol: pages, scripts, mouse, screenshots."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import shutil
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.helpers.waiting import waited

CHROMIUM = next((p for n in ("chromium", "chromium-browser", "google-chrome") if (p := shutil.which(n))), None)
QUIET = ("background-networking", "component-update", "sync", "gpu-sandbox", "dev-shm-usage")


class Page:
    """A page that is open in the browser."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.events: list[dict[str, Any]] = []  # that came while answers were waited for

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Result of a method of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("id") == number:
                assert "error" not in message, message["error"]
                return message["result"]
            self.events.append(message)

    def run(self, script: str) -> Any:
        """Value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_for(self, script: str, seconds: float = 60) -> Any:
        """Value of an expression once it is true."""
        return waited(lambda: self.run(script), seconds, script)

    def screenshot(self, path: Path | None = None) -> np.ndarray:
        """The page as it is shown, (H, W, 3) uint8; also as a PNG file."""
        content = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(content)
        return np.asarray(Image.open(io.BytesIO(content)).convert("RGB"))

    def mouse(self, kind: str, x: float, y: float, buttons: int = 0) -> None:
        """A mouse event of the left button: moved, pressed or released."""
        button = "none" if kind == "moved" and not buttons else "left"
        self.call(
            "Input.dispatchMouseEvent", type=f"mouse{kind.capitalize()}", x=x, y=y, button=button, buttons=buttons,
            clickCount=int(kind != "moved"),
        )  # fmt: skip

    def click(self, x: float, y: float) -> None:
        self.mouse("moved", x, y)
        self.mouse("pressed", x, y, buttons=1)
        self.mouse("released", x, y)


@contextlib.contextmanager
def opened(address: str, profile: Path, width: int = 1280, height: int = 800) -> Iterator[Page]:
    """A page in a headless browser with WebGL in software."""
    from websockets.sync.client import connect

    call = [
        str(CHROMIUM), "--headless=new", "--no-sandbox", "--no-first-run", "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader", "--remote-debugging-port=0", f"--window-size={width},{height}",
        "--hide-scrollbars", f"--user-data-dir={profile}", *(f"--disable-{what}" for what in QUIET), "about:blank",
    ]  # fmt: skip
    browser = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        port_file = profile / "DevToolsActivePort"
        waited(lambda: port_file.exists() and port_file.read_text().count("\n"), 60, "chromium starts")
        port = port_file.read_text().splitlines()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=30) as answer:
            targets = json.load(answer)
        socket_address = next(one["webSocketDebuggerUrl"] for one in targets if one["type"] == "page")
        with connect(socket_address, max_size=None, open_timeout=60, proxy=None) as socket:
            page = Page(socket)
            page.call("Page.enable")
            page.call("Runtime.enable")
            page.call(
                "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False
            )
            page.call("Page.navigate", url=address)
            yield page
    finally:
        browser.terminate()
        browser.wait(30)

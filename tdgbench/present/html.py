"""Pages that open from disk: jinja's environment, and pictures inside a page."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from PIL import Image

from tdgbench.terminal import printable
from tdgbench.text import without_folders

MOST_COLOURS = 256  # of a palette
STEPS = (1, 2, 3, 4, 6, 8)  # one of so many pixels is shown: the first with which a page has at most its size


def environment(package: str) -> Environment:
    """Return an environment of a package's templates, which may use page.css, page.js and grid.html.j2 of this one."""
    folders = ChoiceLoader([PackageLoader(name, ".") for name in (package, "tdgbench.present")])
    found = Environment(
        loader=folders, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        finalize=_visible,
    )  # fmt: skip
    found.filters["zip"] = zip
    return found


def embedded(pixels: np.ndarray, step: int = 1) -> str:
    """Return `png` as a data URI."""
    return "data:image/png;base64," + base64.b64encode(png(pixels, step)).decode()


def png(pixels: np.ndarray, step: int = 1) -> bytes:
    """Return every `step`-th pixel of a picture (H, W, 1, 3 or 4) uint8 as a PNG file; few colours are a palette."""
    pixels = pixels[::step, ::step]
    picture = Image.fromarray(pixels.astype(np.uint8).squeeze(-1) if pixels.shape[2] == 1 else pixels.astype(np.uint8))
    options: dict[str, Any] = {}
    if picture.mode in ("RGB", "RGBA"):
        wide = np.pad(np.asarray(picture), ((0, 0), (0, 0), (0, 4 - pixels.shape[2])))
        colours, index = np.unique(np.ascontiguousarray(wide).view(np.uint32), return_inverse=True)
        if len(colours) <= MOST_COLOURS:
            four = colours.view(np.uint8).reshape(-1, 4)
            options = {"transparency": four[:, 3].tobytes()} if picture.mode == "RGBA" else {}
            picture = Image.fromarray(index.reshape(pixels.shape[:2]).astype(np.uint8))
            picture.putpalette(four[:, :3].tobytes())
    buffer = io.BytesIO()
    picture.save(buffer, "PNG", optimize=True, **options)
    return buffer.getvalue()


def filter_tables(colours: np.ndarray) -> list[str]:
    """Return the colours (256, 3) uint8 of the levels of a gray picture as an SVG filter's tables of red, green, blue.

    >>> filter_tables(np.uint8([[0, 51, 255], [255, 51, 0]]))
    ['0 1', '0.2 0.2', '1 0']
    """
    return [" ".join(f"{value / 255:.3g}" for value in channel) for channel in colours.T]


def _visible(value: Any) -> Any:
    """Return text that tells no folder of the machine, without control characters, which HTML forbids; SVG as it is."""
    if type(value) is not str or value.startswith("data:"):
        return value
    return printable(without_folders(value))

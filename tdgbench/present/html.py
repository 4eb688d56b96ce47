"""Pages that open from disk: jinja's environment, and pictures inside a page."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from PIL import Image

from tdgbench.terminal import printable


def environment(package: str) -> Environment:
    """Return an environment of a package's templates, which may use page.css, page.js and grid.html.j2 of this one."""
    folders = ChoiceLoader([PackageLoader(name, ".") for name in (package, "tdgbench.present")])
    return Environment(
        loader=folders, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        finalize=_visible,
    )  # fmt: skip


def embedded(pixels: np.ndarray) -> str:
    """Return a picture (H, W, 3) uint8 as a data URI."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


def _visible(value: Any) -> Any:
    """Return text without control characters, which HTML forbids, and without changes of direction; SVG as it is."""
    return printable(value) if type(value) is str else value

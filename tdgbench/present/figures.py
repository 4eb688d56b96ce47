"""Figures on disk: written whole or not at all, all at one resolution."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from tdgbench.files import whole_file
from tdgbench.text import shortened

DPI = 110
LONGEST = 80  # characters of a title or a label


def plain(text: str) -> str:
    r"""Return text for a title or label: matplotlib would read `$` as mathematics and hide what begins with `_`.

    >>> print(plain("$x$"), plain("_a"))
    \$x\$  _a
    """
    line = shortened(text, LONGEST).replace("$", r"\$")
    return f" {line}" if line.startswith("_") else line


@contextmanager
def any_font() -> Iterator[None]:
    """Draw without warnings of characters that the font lacks."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph|Matplotlib currently does not support")
        yield


def save_figure(figure: Figure, target: Path) -> None:
    """Write a figure as PNG."""
    with whole_file(target) as part, any_font():
        figure.savefig(part, dpi=DPI)


def as_svg(figure: Figure) -> str:
    """Return a figure as SVG whose black is the page's ink, so that it can be read on light and dark pages."""
    buffer = io.StringIO()
    with any_font(), mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "tdgbench"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, transparent=True)
    text = buffer.getvalue()
    return text[text.index("<svg") :].replace("#000000", "currentColor")

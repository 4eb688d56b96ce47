"""Command line of `tdgbench view`."""

from __future__ import annotations

import argparse
import os
import sys
import time
import webbrowser
from collections.abc import Callable
from pathlib import Path

from tdgbench.cells.known_classes import add_trust_arguments, trust
from tdgbench.terminal import errors_in_one_line, say
from tdgbench.view.cells import Follower, open_cell, open_cells
from tdgbench.view.export import MAX_MB, export

WIDTH = 1280  # px
LOCAL = "127.0.0.1"


@errors_in_one_line("view")
def main(arguments: list[str]) -> int:
    """Show cells until Ctrl-C; return the exit status 1 if they cannot be shown."""
    description = "Look at the models of one or more cells of a scene in the browser."
    parser = argparse.ArgumentParser(prog="tdgbench view", description=description)
    parser.add_argument("cell", nargs="+", type=Path, help="folder results/<experiment>/cells/…/seed<k>")
    parser.add_argument("--host", default=LOCAL, help="address to serve; 0.0.0.0 lets other machines in")
    parser.add_argument("--port", type=_whole_number(0, 65535), help="default: the first free one from 8080 on")
    parser.add_argument(
        "--width", type=_whole_number(16, 8192), default=WIDTH, help=f"most pixels of a picture's width ({WIDTH})"
    )
    parser.add_argument("--no-open", action="store_true", help="open no browser, only print the address")
    one = parser.add_mutually_exclusive_group()
    one.add_argument("--follow", action="store_true", help="results/<experiment>: its training while it runs")
    one.add_argument("--export", metavar="FILE", type=Path, help="write one HTML file that needs no server")
    parser.add_argument(
        "--max-mb", metavar="N", type=_whole_number(1, 150), default=MAX_MB, help=f"its largest size ({MAX_MB})"
    )
    add_trust_arguments(parser)
    options = parser.parse_intermixed_args(arguments)
    trust(options.config_dir, options.trust)
    if len(options.cell) > 1 and (options.export or options.follow):
        raise ValueError(f"--{'export' if options.export else 'follow'} takes one folder, not {len(options.cell)}")
    if options.export:
        say(export(open_cell(options.cell[0]), options.export, options.max_mb))
        return 0
    return _show(options)


def _show(options: argparse.Namespace) -> int:
    try:
        from tdgbench.view.server import Viewer, serving
    except ModuleNotFoundError as error:
        if error.name != "viser":
            raise
        raise ValueError("it needs viser: pip install -e '.[view]'") from error
    follower = Follower(options.cell[0]) if options.follow else None
    if follower is None:
        say(f"loading {', '.join(map(str, options.cell))}", stderr=True)
    cells = open_cells(options.cell) if follower is None else follower.next(time.sleep)
    with serving(options.host, options.port) as server:
        viewer = Viewer(server, cells, options.width)
        try:
            address = f"http://{'localhost' if options.host == '0.0.0.0' else options.host}:{server.get_port()}"
            say(f"{', '.join(cells)}: {address} (Ctrl-C ends it)")
            if not options.no_open and has_screen():
                webbrowser.open_new_tab(address)
            while follower is not None:
                viewer.replace(follower.next(viewer.wait))
            viewer.wait()
        finally:
            viewer.close()
    return 0


def has_screen() -> bool:
    """Return whether a browser can open a window here. Without one, Python may start a browser in the terminal."""
    return not sys.platform.startswith("linux") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _whole_number(least: int, most: int) -> Callable[[str], int]:
    """Return a parser of the whole numbers from `least` to `most`."""

    def parse(text: str) -> int:
        if text.isascii() and text.isdigit() and least <= int(text) <= most:
            return int(text)
        raise argparse.ArgumentTypeError(f"{text!r} is no whole number from {least} to {most}")

    return parse

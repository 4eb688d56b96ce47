"""Command line of `tdgbench data get`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.data.get.fetch import Download, fetch, scene_folders
from tdgbench.data.get.listing import ZENODO
from tdgbench.data.get.sources import SOURCES, GetError
from tdgbench.data.progress import amount
from tdgbench.terminal import say
from tdgbench.text import one_line


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("dataset", choices=SOURCES, help="data set")
    parser.add_argument("root", type=Path, metavar="DIR", help="folder of all data sets, as data.root")
    parser.add_argument("--scene", action="append", default=[], metavar="NAME", help="only this scene; may be repeated")
    parser.add_argument("--list", action="store_true", help="show what would be fetched; fetch nothing")
    parser.add_argument("--force", action="store_true", help="fetch again, and replace scenes that are there")
    parser.add_argument("--zenodo", default=ZENODO, metavar="URL", help="a mirror of Zenodo (default: %(default)s)")


def run(arguments: argparse.Namespace) -> int:
    """Fetch or list a data set; return the exit status: 1 if something is damaged or refused.

    Raises GetError, with the address for a browser and the folder, and OSError for what stops the whole download.
    """
    source = SOURCES[arguments.dataset]
    folder = arguments.root / source.folder
    request = Download(source, folder, tuple(arguments.scene), arguments.force, arguments.zenodo)
    say(f"{source.folder} ({source.paper}): {source.page}")
    try:
        if not arguments.list:
            return 0 if fetch(request) else 1
        show_listing(request)
    except GetError as error:
        raise GetError(
            f"{error}; or open {source.page} in a browser and unpack its scenes to {folder}/<Scene>; if the page is "
            f"gone, ask its authors ({source.authors})"
        ) from error
    return 0


def show_listing(request: Download) -> None:
    """Show each download of a data set: its size, and whether it is there."""
    packages, others = request.listing()
    there = scene_folders(request.source, request.folder)
    for package in packages:
        files = "" if len(package.files) == 1 else f", {len(package.files)} files"
        scene = f", scene {package.scene}" if package.scene else ""
        say(one_line(f"{package.name}{scene}{files}: {amount(package.size)}, {request.state(package, there)}"))
    if others:
        say(one_line(f"not fetched: {', '.join(map(str, others))}"))
    sizes = [package.size for package in packages]
    say(f"in all {amount(None if None in sizes else sum(size or 0 for size in sizes))}")

"""Command line of `tdgbench data get`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.data.get.fetch import fetch, scene_folders, state
from tdgbench.data.get.packages import packages_of
from tdgbench.data.get.sources import SOURCES, ZENODO, GetError, list_files
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
    say(f"{source.folder} ({source.paper}): {source.page}")
    if arguments.list:
        say(source.holds)
        say(f"state of the address: {source.known}")
    try:
        published = list_files(source, arguments.zenodo)
        packages, others = packages_of(source, published.files, arguments.scene)
        if others:
            say(one_line(f"not fetched: {', '.join(map(str, others))}; scenes belong into {folder}"))
        if not arguments.list:
            return 0 if fetch(source, folder, packages, arguments.force) else 1
    except GetError as error:
        raise GetError(
            f"{error}; or open {source.page} in a browser and unpack its scenes to {folder}/<Scene>; if the page is "
            f"gone (last known state: {source.known}), ask its authors ({source.authors})"
        ) from error
    there = scene_folders(source, folder)
    for package in packages:
        scene = f", scene {package.scene}" if package.scene else ""
        files = "" if package.is_archive else f", {len(package.files)} files"
        say(one_line(f"{package.name}{scene}{files}: {amount(package.size)}, {state(package, there, arguments.force)}"))
    if published.licence:
        say(one_line(f"licence, as the record states: {published.licence}"))
    say(f"in all {amount(sum(package.size or 0 for package in packages) or None)}")
    return 0

"""`tdgbench site PACK ... DIR`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.site.packed import opened_packs
from tdgbench.site.site_pages import write_site
from tdgbench.terminal import errors_in_one_line, say


@errors_in_one_line("site")
def main(arguments: list[str]) -> int:
    """Run the tool; return the exit status: 1 if a pack cannot be read, or the folder is there."""
    parser = argparse.ArgumentParser(
        prog="tdgbench site", description="Write web pages from packs: a leaderboard, a page per scene, method, pack."
    )  # fmt: skip
    parser.add_argument("pack", nargs="+", type=Path, metavar="PACK", help="written by tdgbench pack")
    parser.add_argument("folder", type=Path, metavar="DIR", help="the new folder of the pages")
    parser.add_argument("--title", default="", metavar="TEXT", help="of the site; default names the data sets")
    options = parser.parse_intermixed_args(arguments)
    with opened_packs(options.pack) as packs:
        pages = write_site(packs, options.folder, options.title)
    sizes = [path.stat().st_size for path in options.folder.rglob("*") if path.is_file()]
    say(f"{options.folder / 'index.html'}: {pages} pages, {len(sizes)} files, {sum(sizes) / 2**20:.2f} MB")
    return 0

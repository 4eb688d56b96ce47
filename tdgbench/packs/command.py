"""`tdgbench pack DIR` and `tdgbench unpack FILE DIR`."""

from __future__ import annotations

import argparse
from pathlib import Path

from tdgbench.packs.checklist import checklist
from tdgbench.packs.read import unpack
from tdgbench.packs.write import pack
from tdgbench.terminal import errors_in_one_line, say
from tdgbench.text import one_line


@errors_in_one_line("pack")
def main(arguments: list[str]) -> int:
    """Pack an experiment; return the exit status: 1 if it cannot be packed. What the checklist misses is said."""
    parser = argparse.ArgumentParser(prog="tdgbench pack", description="Write an experiment's results to one file.")
    parser.add_argument("experiment", type=Path, metavar="DIR", help="folder results/<experiment>")
    parser.add_argument("--out", type=Path, metavar="FILE", help="default: <experiment>-<hash>.zip beside the folder")
    parser.add_argument("--keep-paths", action="store_true", help="pack although records hold absolute paths")
    options = parser.parse_args(arguments)
    items = checklist(options.experiment)
    path, name = pack(options.experiment, options.out, options.keep_paths)
    for title, missing in items:
        say(one_line(f"{title}: {missing}" if missing else title), "missing:" if missing else "ok:")
    if own := sorted(table.name for table in options.experiment.glob("*.csv")):
        say(one_line(f"not in the pack: {', '.join(own)}, which its experiment writes again"), "data:")
    say(f"{path}: {path.stat().st_size / 2**20:.2f} MB, SHA-256 of its manifest {name}")
    return 0


@errors_in_one_line("unpack")
def unpack_main(arguments: list[str]) -> int:
    """Unpack a file into a new folder; return the exit status: 1 if it is no pack or was changed."""
    parser = argparse.ArgumentParser(prog="tdgbench unpack", description="Unpack results into a new folder.")
    parser.add_argument("pack", type=Path, metavar="FILE", help="written by tdgbench pack")
    parser.add_argument("folder", type=Path, metavar="DIR", help="the new folder, such as results/theirs")
    options = parser.parse_args(arguments)
    content, name = unpack(options.pack, options.folder)
    say(f"{options.folder}: {len(content.files)} files of {content.experiment}, SHA-256 of its manifest {name}")
    say("they are what the pack holds, and are not verified yet: tdgbench verify does that", "data:")
    return 0

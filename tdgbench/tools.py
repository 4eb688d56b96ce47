"""Command-line tools beside the benchmark itself: `tdgbench TOOL ...`."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Tool:
    """A tool, chosen by the first word of the command line.

    usage: (arguments, summary) of each form, for `tdgbench --help`. module: has the function `main(arguments)`, which
    returns the exit status; it is imported when the tool runs.
    """

    usage: tuple[tuple[str, str], ...]
    module: str
    main: str = "main"

    def load(self) -> Callable[[list[str]], int]:
        """Import the tool, and return what runs it with arguments."""
        main: Callable[[list[str]], int] = getattr(importlib.import_module(self.module), self.main)
        return main


TOOLS = {
    "tables": Tool(
        (("[claims|sensitivity] DIR", "tables of results/<experiment>; the paper's claims; other conventions"),),
        "tdgbench.tables.tables_command",
    ),
    "compare": Tool(
        (("A B, score DIR OUT [metrics=...]", "two result folders; DIR scored by another protocol, without training"),),
        "tdgbench.compare.compare_command",
    ),
    "score": Tool((), "tdgbench.rescore.command"),
    "data": Tool(
        (
            ("get NAME DIR, sample DIR", "download a published data set; write a built-in scene as files"),
            ("check DIR, prepare FILES OUT", "which scenes are whole? make a scene of camera files"),
            ("export SCENE OUT, poses A B", "as the authors' programs read it; errors against a reference's poses"),
        ),
        "tdgbench.data.command",
    ),
    "view": Tool(
        (("CELL ... | --follow DIR", "look at models in the browser; at a training while it runs"),),
        "tdgbench.view.command",
    ),
    "verify": Tool(
        (("DIR|PACK ...", "check results against their records: hashes, renders, scores"),), "tdgbench.verify"
    ),
    "pack": Tool(
        (("DIR, unpack PACK DIR, site PACK DIR", "results in one file, to hand on; and back; web pages of packs"),),
        "tdgbench.packs.command",
    ),
    "site": Tool((), "tdgbench.site.site_command"),
    "unpack": Tool((), "tdgbench.packs.command", "unpack_main"),
}

"""Command-line tools beside the benchmark itself, `tdgbench TOOL ...`, and the text of `tdgbench --help`."""

from __future__ import annotations

import importlib
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tdgbench import __version__
from tdgbench.resources import conf_folder
from tdgbench.text import if_class, meant


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
    "new": Tool((("method NAME", "write the files of a method of yours, to begin with"),), "tdgbench.new"),
    "site": Tool((), "tdgbench.site.site_pages"),
    "unpack": Tool((), "tdgbench.packs.command", "unpack_main"),
}

WIDTH = 118
LEFT_WIDTH = 42  # width of the first column

COMMANDS = (
    ("", "the demo: MSMG and TDg on four built-in scenes"),
    ("+experiment=NAME [...]", "run an experiment; the same command again resumes it"),
    ("[-m] [KEY=VALUE ...]", "run one cell; -m: every combination of comma-separated values"),
)
OPTIONS = (
    ("data.root=DIR", "where the data sets are (default: data); dataset=folder: your capture"),
    ("scene=A,B seed=0,1 name=NAME", "scenes, seeds; results are in results/NAME (default single), or results=DIR"),
    ("overwrite=always|never", "repeat finished cells, or keep outdated ones"),
    ("hydra/launcher=joblib", "run cells side by side (also submitit_local, submitit_slurm, ray)"),
    ("--config-dir DIR", "add a folder with your YAML files: DIR/<group>/<choice>.yaml"),
    ("--cfg job, --version, --hydra-help", "print the configuration; the version; Hydra's flags"),
)


def usage() -> str:
    """Return the help, which fits on one screen."""
    conf = conf_folder()
    tools = [(f"{name} {form}", does) for name, tool in TOOLS.items() for form, does in tool.usage]
    sections = {
        f"tdgbench {__version__}: benchmark for thermal Gaussian splatting": [
            (f"tdgbench {form}".rstrip(), does) for form, does in (*COMMANDS, *tools)
        ],
        "Experiments": [(path.stem, _summary(path)) for path in sorted((conf / "experiment").glob("*.yaml"))],
        "Groups, as GROUP=CHOICE": [
            (folder.name, " ".join(sorted(path.stem for path in folder.glob("*.yaml"))))
            for folder in sorted(path for path in conf.iterdir() if path.is_dir() and path.name != "experiment")
        ],
        "Options": list(OPTIONS),
    }
    lines = []
    for title, rows in sections.items():
        lines += [title, *(f"  {left:<{LEFT_WIDTH}} {right}" for left, right in rows)]
    return "\n".join(lines)


def no_tool(words: list[str]) -> str:
    """Return what to write instead of a command line whose first word is no tool.

    >>> no_tool(["vrify", "x"]).partition(" (")[0]
    "no tool 'vrify'; did you mean verify?"
    """
    first, *rest = words
    remedy = meant(first, TOOLS) or if_class(first)
    if not remedy and rest and "=" in rest[0]:
        remedy = f"; a training has no word in front: tdgbench {' '.join(rest)}"
    return f"no tool {first!r}{remedy} (tools: {', '.join(TOOLS)}); see tdgbench --help"


def _summary(path: Path) -> str:
    """Return the first sentence of the first comment of a YAML file, shortened to one line."""
    comments = [line.lstrip("# ").rstrip() for line in path.read_text(encoding="utf-8").splitlines() if line[:1] == "#"]
    text = " ".join(comment for comment in comments if not comment.startswith("@package"))
    return textwrap.shorten(text.split(". ")[0].rstrip("."), WIDTH - LEFT_WIDTH - 2, placeholder=" ...")

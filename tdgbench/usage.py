"""The text of `tdgbench --help`; experiments, groups and choices are read from the configuration."""

from __future__ import annotations

import textwrap
from pathlib import Path

from tdgbench import __version__
from tdgbench.resources import conf_folder
from tdgbench.tools import TOOLS

WIDTH = 118
COLUMN = 42  # width of the first column

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
        lines += [title, *(f"  {left:<{COLUMN}} {right}" for left, right in rows)]
    return "\n".join(lines)


def _summary(path: Path) -> str:
    """Return the first sentence of the first comment of a YAML file, shortened to one line."""
    comments = [line.lstrip("# ").rstrip() for line in path.read_text(encoding="utf-8").splitlines() if line[:1] == "#"]
    text = " ".join(comment for comment in comments if not comment.startswith("@package"))
    return textwrap.shorten(text.split(". ")[0].rstrip("."), WIDTH - COLUMN - 2, placeholder=" ...")

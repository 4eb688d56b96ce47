"""Folders of data files, inside the package in an installed wheel, beside it in a checkout; the folder of plug-ins."""

from __future__ import annotations

import sys
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent


def conf_folder() -> Path:
    """Return the folder of Hydra's configuration groups.

    >>> (conf_folder() / "config.yaml").is_file()
    True
    """
    return _folder("conf")


def paper_tables_folder() -> Path:
    """Return the folder of published numbers and claims.

    >>> (paper_tables_folder() / "table1.csv").is_file()
    True
    """
    return _folder("paper_tables")


def import_from_working_folder() -> None:
    """Let Python find modules in the working folder, behind all others: a user's plug-ins, for what runs them."""
    if not sys.flags.safe_path and str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))


def import_from_no_working_folder() -> None:
    """Take the folder back that `python -m` put first into Python's path, unless tdgbench itself is there.

    Raises OSError if the working folder was deleted.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError as error:
        raise OSError("the working folder was deleted; change to one that is there") from error
    if here != PACKAGE.parent and sys.path[:1] in ([""], [str(here)]):
        del sys.path[0]


def _folder(name: str) -> Path:
    """Raises FileNotFoundError if the installation is incomplete."""
    for parent in (PACKAGE, PACKAGE.parent):
        if (parent / name).is_dir():
            return parent / name
    raise FileNotFoundError(f"{PACKAGE} has no {name}/ inside or beside it; install tdgbench again")

"""Folders of data files: inside the package in an installed wheel, beside the package in a checkout."""

from __future__ import annotations

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


def _folder(name: str) -> Path:
    """Raises FileNotFoundError if the installation is incomplete."""
    for parent in (PACKAGE, PACKAGE.parent):
        if (parent / name).is_dir():
            return parent / name
    raise FileNotFoundError(f"{PACKAGE} has no {name}/ inside or beside it; install tdgbench again")

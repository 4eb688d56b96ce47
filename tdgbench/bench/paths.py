"""Where the files of a cell are."""

from __future__ import annotations

import hashlib
from pathlib import Path

from tdgbench.bench.record import Record


def cell_folder_of(experiment: Path, record: Record) -> Path:
    """<experiment>/cells/<method>/<dataset>/<scene>/<init>/seed<k>[,<variant>].

    >>> record = Record("tdg", "paper", "Truck", "colmap", 0, "table1", "budget.iterations=900")
    >>> cell_folder_of(Path("table1"), record).as_posix()
    'table1/cells/tdg/paper/Truck/colmap/seed0,budget.iterations=900'
    """
    last = f"seed{record.seed}" + (f",{record.variant}" if record.variant else "")
    parts = [record.method, record.dataset or "unknown", record.scene, record.init, last]
    safe = ["".join(c if c.isalnum() or c in "-_.,=+" else "_" for c in part) for part in parts]
    return experiment / "cells" / Path(*safe)


def short_name(experiment: Path, folder: Path) -> str:
    """File name, without suffix, of a cell's lock and checkpoint, which are outside of the cell's `folder`.

    >>> short_name(Path("table1"), Path("table1/cells/tdg/paper/Truck/colmap/seed0"))
    'a946ce4823c29e6e'
    """
    return hashlib.sha256(folder.relative_to(experiment).as_posix().encode()).hexdigest()[:16]

"""Names of a cell's files, and where its folder is."""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import NamedTuple, Protocol

from tdgbench.scenes.modalities import THERMAL

RECORD_FILE = "record.json"
CAMERAS_FILE = "cameras.json"  # of all views, to render the model again without the data
VIEWS_FILE = "views.csv"  # scores of each test view
LOG_FILE = "log.csv"  # lines of the training
PARTS_FILE = "parts.pt"  # parts of the method that rendering needs beside the Gaussians
MASKS = "masks"  # folder: valid pixels of the test views
CHECKPOINTS, RUNNING = "checkpoints", "running"  # folders of an experiment: what cells in training have by `short_name`
DETERMINACY = "determinacy"  # folder: how well the training views determine each pixel of the test views
_MODEL, _RENDERS, _TARGETS = "model", "renders", "targets"
# Files of a cell by relative path; every other file is a stranger there.
CELL_FILE = re.compile(
    "|".join(re.escape(name) for name in (RECORD_FILE, CAMERAS_FILE, VIEWS_FILE, LOG_FILE, PARTS_FILE))
    + rf"|{_MODEL}(_\w+)?\.ply|(({_RENDERS}|{_TARGETS})(_\w+)?|{MASKS}|{DETERMINACY})/[^/]+\.png"
)
LONGEST = 230  # bytes of a folder's name; file systems allow 255, and hidden siblings have longer names


class CellNames(Protocol):
    """What names a cell's folder; a record has it."""

    method: str
    dataset: str
    scene: str
    init: str
    seed: int
    variant: str


def cell_folder_of(experiment: Path, record: CellNames) -> Path:
    """Return <experiment>/cells/<method>/<dataset>/<scene>/<init>/seed<k>[,<variant>].

    >>> from tdgbench.cells.record import Record
    >>> record = Record("tdg", "paper", "Truck", "colmap", 0, "table1", "budget.iterations=900")
    >>> cell_folder_of(Path("table1"), record).as_posix()
    'table1/cells/tdg/paper/Truck/colmap/seed0,budget.iterations=900'
    """
    last = f"seed{record.seed}" + (f",{record.variant}" if record.variant else "")
    parts = [record.method, record.dataset, record.scene, record.init, last]
    return experiment / "cells" / Path(*map(folder_name, parts))


def prior_cache(results: Path) -> Path:
    """Return the folder of the depth priors that the cells of a results folder share."""
    return results / "cache" / "priors"


def folder_name(name: str) -> str:
    """Return a visible folder name of at most 230 bytes; different names give different ones.

    A name that has to be changed carries a hash after `~`, which no unchanged name contains.

    >>> folder_name("a_b"), folder_name("a b"), folder_name("")
    ('a_b', 'a_b~c8687a08', 'unknown~e3b0c442')
    """
    safe = "".join(c if c.isalnum() or c in "-_.,=+" else "_" for c in name)
    if safe == name and name[:1] not in ("", ".") and len(os.fsencode(name)) <= LONGEST:
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    visible = "_" + safe[1:] if safe.startswith(".") else safe or "unknown"
    shortened = visible.encode()[: LONGEST - len(digest) - 1].decode(errors="ignore")
    return f"{shortened}~{digest}"


class ModalityFiles(NamedTuple):
    """Names in a cell's folder: the model of a modality, the folders of its test views' renders and ground truth."""

    model: str
    renders: str
    targets: str


def files_of(modality: str) -> ModalityFiles:
    """Return names of the files of a modality; those of thermal are plain.

    >>> files_of("thermal")
    ModalityFiles(model='model.ply', renders='renders', targets='targets')
    >>> files_of("rgb")
    ModalityFiles(model='model_rgb.ply', renders='renders_rgb', targets='targets_rgb')
    """
    suffix = "" if modality == THERMAL else f"_{modality}"
    return ModalityFiles(f"{_MODEL}{suffix}.ply", f"{_RENDERS}{suffix}", f"{_TARGETS}{suffix}")


def hidden_folder(folder: Path, key: str) -> Path:
    """Return where a finished result of another key is kept once the cell of `folder` has failed.

    >>> hidden_folder(Path("colmap/seed0"), "842371dd379ba6205b90e832234243b1").as_posix()
    'colmap/.seed0-842371dd'
    """
    return folder.with_name(f".{folder.name}-{key[:8]}")


def short_name(experiment: Path, folder: Path) -> str:
    """Return file name, without suffix, of a cell's lock and checkpoint, which are outside of the cell's `folder`.

    >>> short_name(Path("table1"), Path("table1/cells/tdg/paper/Truck/colmap/seed0"))
    'a946ce4823c29e6e'
    """
    return hashlib.sha256(folder.relative_to(experiment).as_posix().encode()).hexdigest()[:16]

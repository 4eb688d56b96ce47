"""The ground truth of a cell against the data that it is said to be of: built-in scenes, made again, or a folder."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from tdgbench.bench.record_of_run import state_assumptions, state_values
from tdgbench.cells.folder import TARGETS, CellFolder
from tdgbench.cells.ground_truth import same_truth, truth_hash, truth_of
from tdgbench.cells.known_classes import built, known_classes
from tdgbench.cells.paths import files_of
from tdgbench.cells.read_files import MOST_PIXELS
from tdgbench.cells.record import Record
from tdgbench.scenes import Scene, SceneError, View
from tdgbench.scenes.datasets import outline_of
from tdgbench.scenes.images import degC_of_values
from tdgbench.scenes.modalities import LABELS, OTHERS, THERMAL, image_of
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.scoring import to_8bit
from tdgbench.text import first_few
from tdgbench.verify.problems import NotCheckedError

BUILT_IN = "tdgbench.scenes.synthetic.SyntheticDataset"  # its loader decides: a record may give any title
MOST_MADE = 2**26  # pixels of all views of the built-in scenes that are made again, those of 87 default ones
MOST_POINTS = 10**5  # of one of them
MAX_DEGC = 1e-3  # between ends of ranges: processors round differently
NAME_IT = "name the folder of its data with --data DIR"


class Truth(NamedTuple):
    """A scene as the data give it. images: thermal ground truth of each test view."""

    images: dict[str, np.ndarray]
    scene: Scene


class TrueData:
    """The ground truth of test views as the data give it."""

    def __init__(self, folder: Path | None, scratch: Path) -> None:
        """folder: of the data sets; None: built-in scenes alone. Those are made in `scratch`, whatever the folder."""
        self._folder, self._scratch = folder, scratch
        self._read: dict[str, Truth] = {}
        self._left = MOST_MADE

    def truth_of(self, record: Record) -> Truth:
        """Return the ground truth of a record's scene.

        Raises NotCheckedError where there are no data, ValueError or SceneError for data that cannot be read.
        """
        stated = record.setting("dataset")
        loader = deepcopy(stated) if isinstance(stated, dict) else {}
        reader = loader
        while isinstance(reader.get("inner"), dict):  # of a data set that changes another one
            reader = reader["inner"]
        is_built_in = reader.get("_target_") == BUILT_IN
        root = self._scratch if is_built_in else self._folder
        if root is None or not loader:
            raise NotCheckedError(NAME_IT)
        key = json.dumps([stated, record.scene, record.channels], sort_keys=True)
        if key not in self._read:
            if is_built_in:
                self._spend(reader)
            reader["root"] = str(root)
            if record.channels and isinstance(reader.get("options"), dict):
                reader["options"]["channels"] = record.channels
            outline = outline_of(built(loader, known_classes("dataset")), record.scene)
            for view in outline.scene.test:  # before one is read, which its options may enlarge
                if view.camera.width * view.camera.height > MOST_PIXELS:
                    raise ValueError(f"{view.name} would have {view.camera.width}×{view.camera.height} px")
            scene = outline.read()
            self._read[key] = Truth({view.name: truth_of(view) for view in scene.test}, scene)
        return self._read[key]

    def _spend(self, loader: dict[str, Any]) -> None:
        """Raise NotCheckedError for a built-in scene that takes long to make, alone or after the others."""
        *sizes, points = (
            loader.get(name, getattr(SyntheticDataset, name)) for name in ("width", "height", "views", "points")
        )
        if not all(isinstance(size, int) and 0 < size <= MOST_MADE for size in [*sizes, points + 1]):
            raise NotCheckedError(f"a built-in scene has no such size; {NAME_IT}")
        pixels = math.prod(sizes)
        if pixels > self._left or points > MOST_POINTS:
            raise NotCheckedError(f"a scene of {'×'.join(map(str, sizes))} px and views takes long to make")
        self._left -= pixels


@contextmanager
def true_data(folder: Path | None) -> Iterator[TrueData]:
    """Yield the data. Raises ValueError for a folder that is not there."""
    if folder is not None and not folder.is_dir():
        raise ValueError(f"--data {folder} is no folder")
    with TemporaryDirectory(prefix="tdgbench-") as scratch:
        yield TrueData(folder, Path(scratch))


def truth_problems(cell: CellFolder) -> Iterator[str]:
    """Yield test views whose stored ground truth is not the one that the record was scored against.

    Records of earlier versions do not say which that was.
    """
    for view, expected in cell.record.truth.items():
        if truth_hash(cell.truth(view)) != expected:
            yield f"{TARGETS}/{view}.png is not the ground truth that was scored"


def data_problems(cell: CellFolder, data: TrueData) -> Iterator[str]:
    """Yield views that are not those of the data, test views with another ground truth, and facts of the record that
    the data contradict. Raises as `TrueData.truth_of`.
    """
    record, title = cell.record, f"{cell.record.dataset}/{cell.record.scene}"
    try:
        truth, scene = data.truth_of(record)
    except SceneError as error:
        raise ValueError(str(error)) from error
    for name, words in {"dataset": "data set", "split": "split", "group": "group"}.items():
        if getattr(record, name) != getattr(scene, name):
            yield f"its {words} is {getattr(record, name)}, that of the data {getattr(scene, name)}"
    for words, cameras, views in (
        ("training", cell.cameras["train"], scene.train),
        ("test", cell.test_cameras, scene.test),
    ):
        if unknown := set(cameras) ^ {view.name for view in views}:
            yield f"its {words} views are not those of the data: {first_few(unknown)}"
    there = [view for view in scene.test if view.name in cell.test_cameras]
    of_modality = {THERMAL: [one.name for one in there if not same_truth(cell.truth(one.name), truth[one.name])]}
    for modality in OTHERS:
        kind = files_of(modality).targets
        of_modality[modality] = [
            one.name
            for one in there
            if cell.has(kind, one.name) and not _is_picture_of(one, modality, cell.picture(kind, one.name))
        ]
    for modality, other in of_modality.items():
        if other:
            what = "ground truth" if modality == THERMAL else f"{LABELS[modality]} ground truth"
            yield f"the {what} of {len(other)} of {len(there)} test views is not that of {title}: {first_few(other)}"
    stated, span = record.temperature_range, degC_of_values(scene)
    if not (stated == span or (stated and span and np.allclose(stated, span, rtol=0, atol=MAX_DEGC))):
        yield f"temperature_range is {stated}, by the data {span}"
    by_data = replace(record)
    state_assumptions(by_data, scene)
    state_values(by_data, scene)
    if record.assumed and (record.assumed.keys() != by_data.assumed.keys() or record.in_palette != by_data.in_palette):
        yield f"what it assumes ({first_few(record.assumed)}) is not what the data need ({first_few(by_data.assumed)})"


def _is_picture_of(view: View, modality: str, stored: np.ndarray) -> bool:
    """Return whether a stored picture (H, W, C) uint8 is the view's image of a modality, but for rounding."""
    image = image_of(view, modality)
    return image is not None and same_truth(stored, to_8bit(image))

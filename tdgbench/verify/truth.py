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
from tdgbench.scenes import Scene, SceneError
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
    """What the data say of a scene. images: 8-bit ground truth of each test view, by modality. views: names, by part.

    facts: fields of a record. range: °C of 0 and 1, if it is known.
    """

    images: dict[str, dict[str, np.ndarray]]
    views: dict[str, set[str]]
    facts: dict[str, str]
    range: list[float] | None
    in_palette: bool


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
            self._read[key] = _truth_of(scene, record)
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


def _truth_of(scene: Scene, record: Record) -> Truth:
    """Return what a scene that was read says of a record's cell."""
    images = {THERMAL: {view.name: truth_of(view) for view in scene.test}}
    for modality in OTHERS:
        shown = {view.name: image_of(view, modality) for view in scene.test}
        images[modality] = {name: to_8bit(image) for name, image in shown.items() if image is not None}
    views = {part: {view.name for view in of_part} for part, of_part in (("train", scene.train), ("test", scene.test))}
    facts = {"data set": scene.dataset, "split": scene.split, "group": scene.group}
    by_data = replace(record)
    state_assumptions(by_data, scene)
    state_values(by_data, scene)
    return Truth(images, views, facts, degC_of_values(scene), by_data.in_palette)


def data_problems(cell: CellFolder, data: TrueData) -> Iterator[str]:
    """Yield views that are not those of the data, test views with another ground truth, and facts of the record that
    the data contradict. Raises as `TrueData.truth_of`.
    """
    record = cell.record
    try:
        truth = data.truth_of(record)
    except SceneError as error:
        raise ValueError(str(error)) from error
    stated = {"data set": record.dataset, "split": record.split, "group": record.group}
    yield from (f"its {name} is {stated[name]}, that of the data {fact}" for name, fact in truth.facts.items()
                if stated[name] != fact)  # fmt: skip
    for part, words in (("train", "training"), ("test", "test")):
        if unknown := {*cell.cameras[part]} ^ truth.views[part]:
            yield f"its {words} views are not those of the data: {first_few(unknown)}"
    views = [view for view in cell.test_cameras if view in truth.views["test"]]
    for modality, images in truth.images.items():
        if other := [view for view in views if not _is_truth(cell, view, modality, images)]:
            what = f"{'' if modality == THERMAL else f'{LABELS[modality]} '}ground truth"
            scene = f"{record.dataset}/{record.scene}"
            yield f"the {what} of {len(other)} of {len(views)} test views is not that of {scene}: {first_few(other)}"
    of_record, span = record.temperature_range, truth.range
    if not (of_record == span or (of_record and span and np.allclose(of_record, span, rtol=0, atol=MAX_DEGC))):
        yield f"temperature_range is {of_record}, by the data {span}"
    if record.assumed and record.in_palette != truth.in_palette:
        yield f"it says that images are {'' if record.in_palette else 'not '}in a palette; the data do not"


def _is_truth(cell: CellFolder, view: str, modality: str, images: dict[str, np.ndarray]) -> bool:
    """Return whether a stored ground truth, if there is one, is that of the data."""
    if modality == THERMAL:
        return same_truth(cell.truth(view), images[view])
    kind = files_of(modality).targets
    return not cell.has(kind, view) or (view in images and same_truth(cell.picture(kind, view), images[view]))

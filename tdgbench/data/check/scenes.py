"""Check scenes one by one: what is there, what is missing or broken. A broken scene does not end the check."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tdgbench.data.check.alignment import Offset, ViewPair, chosen_views, edge_offset
from tdgbench.data.check.model import wrong_views
from tdgbench.scenes import Dataset, FolderDataset, ReadOptions, RegisteredDataset, Scene, SceneError, registry
from tdgbench.scenes.datasets import outline_of
from tdgbench.scenes.formats import SUFFIXES, decode
from tdgbench.scenes.inputs import is_folder, is_hidden, listed
from tdgbench.scenes.layouts import LAYOUTS, detect
from tdgbench.scenes.registry import plain_name

MOST_PROBLEMS = 20  # of a scene, in words


@dataclass
class SceneCheck:
    """What is known of a scene; the fields are those of the JSON (docs/data.md).

    sizes_px: (width, height) of the views. temperature_degC:
    of image values 0 and 1. counts: raw counts of them, of scenes without °C. masked_share: of the thermal pixels.
    edge_offset: of thermal from RGB edges, or why it is not known. problems: what is missing or broken, with the
    remedy; a scene without one can be used. doubts: what is probably wrong. assumed: how files were read, by key.
    """

    name: str
    dataset: str
    status: Literal["ok", "doubtful", "missing", "broken"] = "ok"
    folder: str | None = None
    layout: str | None = None
    views: int = 0
    views_with_rgb: int = 0
    train: int = 0
    test: int = 0
    sizes_px: list[tuple[int, int]] = field(default_factory=list)
    channels: int | None = None
    temperature_degC: tuple[float, float] | None = None
    counts: tuple[int, int] | None = None
    masked_share: float | None = None
    points: int | None = None
    edge_offset: Offset | str | None = None
    problems: list[str] = field(default_factory=list)
    doubts: list[str] = field(default_factory=list)
    assumed: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Place:
    """The scenes to check. root: data.root. names: of those that should be there. is_paper: whether the paper's."""

    root: Path
    dataset: Dataset
    names: list[str]
    is_paper: bool
    is_other: bool = False  # holds files, but neither a scene nor a data set of the paper


def find_place(root: Path, split: str) -> Place:
    """Find out which scenes should be in a folder.

    A folder that is, or holds, one of the paper's data sets should have the paper's scenes. Any other folder should
    have the scenes that it is or holds, in any layout. If it has none, the paper's scenes are all missing.
    """
    options = ReadOptions(split=split)  # type: ignore[arg-type]
    titles = {plain_name(title): key for key, title in registry.DATASETS.items()}
    key = titles.get(plain_name(root.resolve().name))
    if key is not None and is_folder(root):
        dataset = RegisteredDataset(str(root.resolve().parent), options, key)
        parent = root.resolve().parent if root.name in ("", "..") else root.parent
        return Place(parent, dataset, dataset.names(), is_paper=True)
    paper = RegisteredDataset(str(root), options)
    if not is_folder(root) or any(is_folder(registry.dataset_folder(root, key)) for key in registry.DATASETS):
        return Place(root, paper, paper.names(), is_paper=True)
    folder = FolderDataset(str(root), options)
    names = folder.names()
    if names:
        return Place(root, folder, names, is_paper=False)
    for layout in LAYOUTS:  # a data set's folder inside a data root, as `data get` makes it
        inside = FolderDataset(str(root), options, layout)
        if names := inside.names():
            return Place(root, inside, names, is_paper=False)
    is_other = any(not is_hidden(path.name) for path in listed(root))
    return Place(root, paper, paper.names(), is_paper=True, is_other=is_other)


def check_scenes(place: Place, begin: Callable[[str], None]) -> Iterator[SceneCheck]:
    """Check all scenes of a place; `begin` is called with the name of each one that is there."""
    missing = set(place.dataset.missing(place.names))
    for name in place.names:
        described = place.dataset.describe(name)
        check = SceneCheck(name, described.dataset)
        if name in missing:
            check.status = "missing"
            remedy = ""
            if place.is_paper:
                key = registry.registered(name).dataset
                remedy = f": tdgbench data get {key} {shlex.quote(str(place.root))} (or {registry.PUBLISHED_AT[key]})"
            check.problems.append(f"not there{remedy}")
        else:
            begin(name)
            _examine(place.dataset, check)
        yield check


def _examine(dataset: Dataset, check: SceneCheck) -> None:
    """Read a scene and its images, and fill in what is found."""
    try:
        outline = outline_of(dataset, check.name)
        try:
            scene = outline.read()
        except SceneError as error:
            check.problems.append(str(error))
            _find_broken_images(outline.scene, check)
        else:
            _describe(scene, check)
            _check_model(scene, check)
            _read_rgb(scene, check)
            _ = scene.extent
    except SceneError as error:
        check.problems.append(str(error))
    check.status = "broken" if check.problems else "doubtful" if check.doubts else "ok"
    check.problems = check.problems[:MOST_PROBLEMS]


def _describe(scene: Scene, check: SceneCheck) -> None:
    views = scene.views
    check.folder = str(scene.folder)
    layout = None if scene.folder is None else detect(scene.folder)
    check.layout = None if layout is None else layout.title
    check.views, check.train, check.test = len(views), len(scene.train), len(scene.test)
    check.sizes_px = sorted({(view.camera.width, view.camera.height) for view in views})
    check.channels = scene.channels
    check.points = None if scene.points is None else len(scene.points.points)
    span = scene.temperature
    check.temperature_degC = None if span is None or scene.channels != 1 else (span.min, span.max)
    check.counts = scene.raw_count_range
    check.masked_share = float(np.mean([0.0 if view.valid is None else 1 - view.valid.mean() for view in views]))
    check.views_with_rgb = sum(view.load_rgb is not None for view in views)
    check.doubts, check.assumed = scene.doubts, scene.assumed
    check.notes += scene.notes
    if check.views_with_rgb < len(views):
        check.notes.append(
            f"{len(views) - check.views_with_rgb} views have no RGB image; methods that train on RGB (msmg) need those "
            "of all training views"
        )
    if check.points is None:
        check.notes.append("no sparse points: use init=random; prior=sfm_points is not possible")


def _check_model(scene: Scene, check: SceneCheck) -> None:
    """Add the views whose camera is wrong; where most are, the cameras may have been edited, which is noted."""
    wrong = [] if scene.model is None else wrong_views(scene.model)
    if len(wrong) <= len(scene.views) / 2:
        check.problems += wrong
    else:
        check.notes.append(
            f"the sparse points do not project to where {len(wrong)} views show them; were cameras edited?"
        )


def _read_rgb(scene: Scene, check: SceneCheck) -> None:
    """Read each RGB image; some of them give the offset of edges."""
    views = [view for view in scene.views if view.load_rgb is not None]
    used = chosen_views(len(views))
    pairs = []
    for index, view in enumerate(views):
        rgb = _read(view.load_rgb, check)  # not view.rgb, which would stay in memory
        if index in used and rgb is not None:
            pairs.append(ViewPair(rgb, view.thermal, view.valid))
    if len({pair.rgb.shape[:2] for pair in pairs}) > 1:
        check.edge_offset = "views have different sizes"
    else:
        check.edge_offset = edge_offset(pairs) if views else "no RGB images"


def _find_broken_images(scene: Scene, check: SceneCheck) -> None:
    """Add the images that cannot be read: loading a scene ends at the first one, whose error is there."""
    (said,) = check.problems
    for view in scene.views:
        path = view.thermal_path
        if path is not None and path.suffix.lower() in SUFFIXES and str(path) not in said:
            _read(partial(decode, path), check)
        _read(view.load_rgb, check)


def _read(load: Callable[[], Any] | None, check: SceneCheck) -> Any:
    """Read an image, if there is one; None, and a problem, if it cannot be read."""
    try:
        return None if load is None else load()
    except SceneError as error:
        check.problems.append(str(error))
        return None

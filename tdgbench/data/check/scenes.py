"""Check scenes one by one: what is there, what is missing or broken. A broken scene does not end the check."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from tdgbench.data.check.alignment import Offset, Untrusted, ViewPair, edge_offset
from tdgbench.scenes import Dataset, FolderDataset, ReadOptions, RegisteredDataset, Scene, SceneError, View, registry
from tdgbench.scenes.images import SUFFIXES, read_pixels
from tdgbench.scenes.inputs import is_folder, listed
from tdgbench.scenes.layouts import detect
from tdgbench.scenes.layouts.layout import find_files

VIEWS_FOR_OFFSET = 24  # views of a scene whose edges are compared
MOST_PROBLEMS = 20  # of a scene, in words

# Numbers of views that the authors publish. RGBT-Scenes: camera files in `<Scene>/raw_images/` of the folder that
# ThermalGaussian's README names (Google Drive 1xuPwqezNW_LSB5C-H8TQFJ7nLoSS2BOg). GlassCup and the dark scene come from
# a later extension and were not counted; neither was ThermalMix (Zenodo record 11065834), "about 60" views a scene.
PUBLISHED_VIEWS = {
    "Dimsum": 154,
    "DailyStuff": 78,
    "Ebike": 48,
    "RoadBlock": 71,
    "Truck": 73,
    "RotaryKiln": 106,
    "Parterre": 66,
}


@dataclass
class SceneCheck:
    """What is known of a scene.

    published: number of views that its authors publish, where known. rgb: views with an RGB image. sizes: (width,
    height) of the views, px. temperature: °C of image values 0 and 1. counts: raw counts of them, of scenes without °C.
    masked: share of the thermal pixels that were not measured. offset: of thermal from RGB edges. problems: what is
    missing or broken, with the remedy; a scene without one can be used.
    """

    name: str
    dataset: str
    status: Literal["ok", "missing", "broken"] = "ok"
    folder: str = ""
    layout: str = ""
    views: int = 0
    published: int | None = None
    train: int = 0
    test: int = 0
    rgb: int = 0
    sizes: list[tuple[int, int]] = field(default_factory=list)
    channels: int | None = None
    temperature: tuple[float, float] | None = None
    counts: tuple[int, int] | None = None
    masked: float | None = None
    points: int | None = None
    offset: Offset | Untrusted | None = None
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Place:
    """Scenes to look for. root: data.root. names: all that should be there. is_paper: whether the paper's."""

    root: Path
    dataset: Dataset
    names: list[str]
    is_paper: bool


def find_place(root: Path, split: str) -> Place:
    """Find out which scenes should be in a folder.

    The paper's, if it holds a folder of one of their data sets, or is one; else those that it holds or is, in whatever
    layout. Of an empty folder or none, the paper's, all of which are missing.
    """
    options = ReadOptions(split=split)  # type: ignore[arg-type]
    titles = {title.lower(): key for key, title in registry.DATASETS.items()}
    key = titles.get(root.resolve().name.lower())
    if key is not None and is_folder(root):
        dataset = RegisteredDataset(str(root.resolve().parent), options, key)  # type: ignore[arg-type]
        return Place(root.parent, dataset, dataset.names(), is_paper=True)
    paper = RegisteredDataset(str(root), options)
    if not is_folder(root) or any(path.name.lower() in titles and is_folder(path) for path in listed(root)):
        return Place(root, paper, paper.names(), is_paper=True)
    folder = FolderDataset(str(root), options)
    names = folder.names()
    if names:
        return Place(root, folder, names, is_paper=False)
    return Place(root, paper, paper.names(), is_paper=True)


def check_scenes(place: Place, begin: Callable[[str], None]) -> Iterator[SceneCheck]:
    """Check all scenes of a place; `begin` is called with the name of each one that is there."""
    missing = set(place.dataset.missing(place.names))
    for name in place.names:
        described = place.dataset.describe(name)
        check = SceneCheck(name, described.dataset, published=PUBLISHED_VIEWS.get(name) if place.is_paper else None)
        if name in missing:
            check.status = "missing"
            check.problems.append(_where_from(name, place.root) if place.is_paper else "it is not there")
        else:
            begin(name)
            _examine(place.dataset, check)
        yield check


def _where_from(name: str, root: Path) -> str:
    key = registry.registered(name).dataset
    return f"not there: tdgbench data get {key} {root} (or {registry.PUBLISHED_AT[key]})"


def _examine(dataset: Dataset, check: SceneCheck) -> None:
    """Read a scene and its images, and fill in what is found."""
    try:
        scene = dataset.load(check.name)
        _describe(scene, check)
    except SceneError as error:
        check.problems.append(str(error))
        check.problems += _broken_images(dataset, check.name, said=str(error))
    else:
        with _as_problem(check):
            _ = scene.extent
        _read_rgb(scene, check)
    if check.problems:
        check.status = "broken"
    check.problems = check.problems[:MOST_PROBLEMS]


def _describe(scene: Scene, check: SceneCheck) -> None:
    views = scene.views
    check.folder = str(scene.folder)
    layout = None if scene.folder is None else detect(scene.folder)
    check.layout = "" if layout is None else layout.title
    check.views, check.train, check.test = len(views), len(scene.train), len(scene.test)
    check.sizes = sorted({(view.camera.width, view.camera.height) for view in views})
    check.channels = scene.channels
    check.points = None if scene.points is None else len(scene.points.points)
    span = scene.temperature
    check.temperature = None if span is None or scene.channels != 1 else (span.min, span.max)
    check.counts = scene.counts
    check.masked = float(np.mean([0.0 if view.valid is None else 1 - view.valid.mean() for view in views]))
    check.rgb = sum(view.load_rgb is not None for view in views)
    check.notes += scene.notes
    if check.rgb < len(views):
        check.notes.append(
            f"{len(views) - check.rgb} views have no RGB image; methods that train on RGB (msmg) need those of all "
            "training views"
        )
    if check.points is None:
        check.notes.append("no sparse points: use init=random; prior=sfm_points is not possible")
    if check.published is not None and check.views < check.published:
        check.notes.append(f"{check.views} views can be used of {check.published} published ones")


def _read_rgb(scene: Scene, check: SceneCheck) -> None:
    """Read each RGB image; some of them give the offset of edges."""
    views = [view for view in scene.views if view.load_rgb is not None]
    used = set(np.linspace(0, len(views) - 1, min(VIEWS_FOR_OFFSET, len(views))).round().astype(int))
    pairs = []
    for index, view in enumerate(views):
        with _as_problem(check):
            rgb = _rgb_of(view)
            if index in used:
                pairs.append(ViewPair(rgb, view.thermal, view.valid))
    sizes = {pair.rgb.shape[:2] for pair in pairs}
    if len(sizes) > 1:
        check.offset = Untrusted("views have different sizes")
    else:
        check.offset = edge_offset(pairs) if views else Untrusted("no RGB images")


def _rgb_of(view: View) -> np.ndarray:
    """Read the RGB image of a view, which the view does not keep."""
    assert view.load_rgb is not None
    return view.load_rgb()


@contextmanager
def _as_problem(check: SceneCheck) -> Iterator[None]:
    """Context in which a SceneError becomes a problem."""
    try:
        yield
    except SceneError as error:
        check.problems.append(str(error))


def _broken_images(dataset: Dataset, name: str, said: str) -> Iterator[str]:
    """Yield the images of a scene that cannot be read, besides those already said: loading ends at the first one."""
    folder = _folder_of(dataset, name)
    for sub in ("thermal", "warped_thermal", "rgb", "images", "masks"):
        try:
            files = find_files(folder / sub, SUFFIXES)[0] if folder is not None and is_folder(folder / sub) else {}
        except SceneError as error:
            yield from [str(error)] if str(error) != said else []
            continue
        for path in files.values():
            try:
                read_pixels(path)
            except SceneError as error:
                if str(path) not in said:
                    yield str(error)


def _folder_of(dataset: Dataset, name: str) -> Path | None:
    """Return the folder of a scene that cannot be loaded."""
    root = getattr(dataset, "root", None)
    if not isinstance(root, Path):
        return None
    if isinstance(dataset, RegisteredDataset):
        scene = registry.registered(name)
        return scene.find(root / registry.DATASETS[scene.dataset])
    return root if detect(root) is not None else root / name

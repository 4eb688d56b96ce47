"""Check scenes one by one: what is there, what is missing or broken. A broken scene does not end the check."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pycolmap

from tdgbench.data.check.registration import Offset, ViewPair, chosen_views, edge_offset, registration
from tdgbench.scenes import Dataset, FolderDataset, ReadOptions, RegisteredDataset, Scene, SceneError, registry
from tdgbench.scenes.colmap.model import FORMATS, model_files
from tdgbench.scenes.colmap.tables import ImageEntry
from tdgbench.scenes.datasets import outline_of
from tdgbench.scenes.formats import SUFFIXES, decode
from tdgbench.scenes.inputs import is_folder, is_hidden, listed
from tdgbench.scenes.layouts import LAYOUTS, detect
from tdgbench.scenes.registry import plain_name

MOST_PROBLEMS = 20  # of a scene, in words
FEWEST, MOST = 10, 1000  # points of a view by which it is judged
FAR = 0.05  # median error of a wrong view, × diagonal of the image; COLMAP drops what is 4 px off, some 0.005
NO_POINT = np.uint64(2**64 - 1)  # of a 2-D point, in place of its point's id


@dataclass
class SceneCheck:
    """What is known of a scene; the fields are those of the JSON (docs/data.md)."""

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
    edge_offset_px: float | None = None
    edge_offset: Offset | None = None
    edge_offset_unknown: str | None = None
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
    for layout in (None, *LAYOUTS):  # then a data set's folder inside a data root, as `data get` makes it
        inside = FolderDataset(str(root), options, layout)
        if names := inside.names():
            return Place(root, inside, names, is_paper=False)
    is_other = any(not is_hidden(path.name) for path in listed(root))
    return Place(root, paper, paper.names(), is_paper=True, is_other=is_other)


def check_scenes(place: Place, begin: Callable[[str], None]) -> Iterator[SceneCheck]:
    """Check all scenes of a place; `begin` is called with the name of each one that is there."""
    missing = set(place.dataset.missing(place.names))
    for name in place.names:
        if name not in missing:
            begin(name)
            yield _examined(place.dataset, name)
            continue
        remedy = ""
        if place.is_paper:
            key = registry.registered(name).dataset
            remedy = f": tdgbench data get {key} {shlex.quote(str(place.root))}"
        yield SceneCheck(name, place.dataset.describe(name).dataset, "missing", problems=[f"not there{remedy}"])


def _examined(dataset: Dataset, name: str) -> SceneCheck:
    """Read a scene and its images, and return what is found."""
    check = SceneCheck(name, dataset.describe(name).dataset)
    try:
        outline = outline_of(dataset, name)
        try:
            scene = outline.read()
        except SceneError as error:
            check.problems = [str(error), *_broken_images(outline.scene, str(error))]
        else:
            check = _described(scene, check.dataset)
            _ = scene.extent
    except SceneError as error:
        check.problems.append(str(error))
    check.status = "broken" if check.problems else "doubtful" if check.doubts else "ok"
    check.problems = check.problems[:MOST_PROBLEMS]
    return check


def _described(scene: Scene, dataset: str) -> SceneCheck:
    """Return what is found in a scene that could be read; its RGB images are read here."""
    views, span = scene.views, scene.temperature
    layout = None if scene.folder is None else detect(scene.folder)
    with_rgb = sum(view.load_rgb is not None for view in views)
    notes = list(scene.notes)
    if with_rgb < len(views):
        notes.append(
            f"{len(views) - with_rgb} views have no RGB image; methods that train on RGB (msmg) need those of all "
            "training views"
        )
    if scene.points is None:
        notes.append("no sparse points: use init=random; prior=sfm_points is not possible")
    wrong = wrong_views(scene)
    if len(wrong) > len(views) / 2:
        notes.append(f"the sparse points do not project to where {len(wrong)} views show them; were cameras edited?")
        wrong = []
    offset, unread = _edge_offset(scene)
    known, unknown = (offset, None) if isinstance(offset, Offset) else (None, offset)
    doubts, uncertain = ([], []) if known is None else registration(scene, known)
    if with_rgb and unknown:
        uncertain = [f"whether RGB and thermal images are registered is not known: {unknown}"]
    return SceneCheck(
        name=scene.name,
        dataset=dataset,
        folder=str(scene.folder),
        layout=None if layout is None else layout.title,
        views=len(views),
        views_with_rgb=with_rgb,
        train=len(scene.train),
        test=len(scene.test),
        sizes_px=sorted({(view.camera.width, view.camera.height) for view in views}),
        channels=scene.channels,
        temperature_degC=None if span is None or scene.channels != 1 else (span.min, span.max),
        counts=scene.raw_count_range,
        masked_share=float(np.mean([0.0 if view.valid is None else 1 - view.valid.mean() for view in views])),
        points=None if scene.points is None else len(scene.points.points),
        edge_offset_px=None if known is None else known.px,
        edge_offset=known,
        edge_offset_unknown=unknown,
        problems=[*wrong, *unread],
        doubts=[*scene.doubts, *doubts],
        assumed=scene.assumed,
        notes=[*notes, *uncertain],
    )


def _edge_offset(scene: Scene) -> tuple[Offset | str, list[str]]:
    """Return the offset of edges, or why it is not known, and the problems of RGB images, each of which is read."""
    views = [(view, view.load_rgb) for view in scene.views if view.load_rgb is not None]
    used, pairs, problems = chosen_views(len(views)), [], []
    for index, (view, load_rgb) in enumerate(views):
        try:
            rgb = load_rgb()  # not view.rgb, which would stay in memory
        except SceneError as error:
            problems.append(str(error))
        else:
            pairs += [ViewPair(rgb, view.thermal, view.valid)] if index in used else []
    if len({pair.rgb.shape[:2] for pair in pairs}) > 1:
        return "views have different sizes", problems
    return edge_offset(pairs) if views else "no RGB images", problems


def _broken_images(scene: Scene, said: str) -> list[str]:
    """Return why images cannot be read: loading a scene ends at the first one, whose error was `said`."""
    problems = []
    for view in scene.views:
        loads: list[Callable[[], object]] = [] if view.load_rgb is None else [view.load_rgb]
        path = view.thermal_path
        if path is not None and path.suffix.lower() in SUFFIXES and str(path) not in said:
            loads.insert(0, partial(decode, path))
        for load in loads:
            try:
                load()
            except SceneError as error:
                problems.append(str(error))
    return problems


def wrong_views(scene: Scene) -> list[str]:
    """Return a problem per view of the scene's COLMAP model whose points project far from where it shows them.

    Models without 2-D points, and ones that are not read, have none. Points may have been removed.
    """
    folder, points = scene.model, scene.points
    if folder is None or points is None or points.ids is None:
        return []
    try:
        cameras_file, images_file, _ = model_files(folder)
        reader = FORMATS[cameras_file.suffix]
        cameras = {
            row.id: pycolmap.Camera(model=row.model, width=row.width, height=row.height, params=list(row.params))
            for row in reader.read_cameras(cameras_file)
        }
        views = [(row, cameras[row.camera_id]) for row in reader.read_images(images_file, observed=True)]
    except (SceneError, LookupError, ValueError, TypeError):  # the last of pycolmap, for a size that no camera has
        return []
    ids, xyz, problems = points.ids, points.points + scene.origin, []
    for image, camera in views:
        shown = image.points[image.points["point"] != NO_POINT]
        place = np.searchsorted(ids, shown["point"])
        known = place < len(ids)
        known[known] = ids[place[known]] == shown["point"][known]
        if known.sum() < FEWEST:
            continue
        sample = np.flatnonzero(known)[:: -(-known.sum() // MOST)]
        errors = _errors(image, camera, shown["xy"][sample], xyz[place[sample]])
        share = float(np.median(errors)) / float(np.hypot(camera.width, camera.height))
        if share > FAR:
            off = f"project {share:.0%} of the diagonal off" if np.isfinite(share) else "lie behind it"
            problems.append(
                f"{image.name}: the points that it shows {off}; its pose or its camera in {folder} is wrong"
            )
    return problems


def _errors(image: ImageEntry, camera: pycolmap.Camera, xy: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Return how far (N,) px from their places (N, 2) in an image points (N, 3) project; inf for those behind it."""
    pose = image.pose
    projected = np.asarray(camera.img_from_cam(xyz @ pose[:, :3].T + pose[:, 3]))
    return np.where(np.isfinite(projected).all(axis=1), np.hypot(*(xy - projected).T), np.inf)

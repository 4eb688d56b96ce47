"""What every layout says about a folder, and the steps that layouts share.

Masks: COLMAP 02e8ba8, doc/faq.rst (left/1.jpg.png below the masks' folder for left/1.jpg; black hides); nerfstudio
50e0e3c, nerfstudio/data/utils/data_utils.py (`mask_path` per frame; 0 hides); NVlabs/instant-ngp 090aed6,
src/nerf_loader.cu (dynamic_mask_1.png beside 1.jpg; what is not black hides).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tdgbench.scenes.colmap import RegisteredImage, read_model
from tdgbench.scenes.colmap.model import read_images
from tdgbench.scenes.colmap.tables import ImageEntry
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import SUFFIXES
from tdgbench.scenes.inputs import check_view_name, is_folder, is_there, listed, regular_file
from tdgbench.scenes.names import about_unread, in_other_folders, key, of_modality, pair, view_names
from tdgbench.scenes.scene import PointCloud
from tdgbench.scenes.temperature import Radiometry, read_radiometry, temperature_file
from tdgbench.scenes.thermal import ThermalRequest
from tdgbench.scenes.view_images import Mask, ThermalImages
from tdgbench.text import first_few

DYNAMIC = "dynamic_mask_"
MASKS = "masks"
SPLITS = ("train", "test")
SAME_POSE = 1e-6  # largest difference between poses of one camera


@dataclass(frozen=True)
class SceneFiles:
    """What a layout found in the folder of a scene; paths, poses and splits are by view name."""

    posed: dict[str, RegisteredImage]
    points: PointCloud | None
    thermal: dict[str, Path] = field(default_factory=dict)  # of views; and of images without a pose, by key
    rgb: dict[str, Path] = field(default_factory=dict)
    shipped: dict[str, str] = field(default_factory=dict)  # `train` or `test`
    radiometry: Radiometry | None = None  # of 8- and 16-bit images
    read_thermal: Callable[[ThermalRequest], ThermalImages] | None = None  # None: as images or cameras' files are read
    files: list[Path] = field(default_factory=list)  # besides images and masks: what the scene is read from
    notes: list[str] = field(default_factory=list)  # what is doubtful about it
    masks: dict[str, Mask] = field(default_factory=dict)
    assumed: dict[str, str] = field(default_factory=dict)  # as of Scene
    model: Path | None = None  # folder of the COLMAP model


class Images(NamedTuple):
    """Files of images below a folder, by key or by view name."""

    paths: dict[str, Path]
    shipped: dict[str, str]  # `train` or `test`, where these subfolders exist; no part of keys
    notes: list[str]  # on files that are not read


@dataclass(frozen=True)
class Layout:
    """How the folder of a scene is organised."""

    name: str  # of the data set that is shipped in it; option `dataset`
    title: str  # of the data set, as results, messages and folders name it
    looks: str  # inside the folder of a scene, in one line
    fits: Callable[[Path], bool]  # whether a folder has this layout; raises SceneError if that cannot be told
    find: Callable[[Path], SceneFiles]  # raises SceneError naming the file and the remedy


def find_scene(
    folder: Path, places: Iterable[str], title: str, modality: tuple[str, str], thermal: Images, rgb: Images
) -> SceneFiles:
    """Pair the images of a scene with its COLMAP model, below the first of `places` that has one. Raises SceneError.

    modality: folders of images with the thermal images' poses and of others in the model's names, where it has both.
    """
    kept = {one: thermal.paths[one] for one in of_modality(thermal.paths, *modality)}
    if apart := thermal.paths.keys() - kept.keys():
        thermal.notes.append(f"{len(apart)} images are not in {modality[0]}/ and are not used: {first_few(apart)}")
    thermal = thermal._replace(paths=kept)
    place, entries, assumed, notes = _chosen_model(folder, places, title, thermal, modality)
    posed, points, others = read_model(place, modality, entries)
    shown = by_view(folder, thermal, posed)
    if across := in_other_folders(pair(thermal.paths, _keys(posed), str(folder)), _keys(posed)):
        assumed = {**assumed, "names": f"paired by base names: {across}"}
    pictures, unpaired = _registered_pairs(folder, rgb, posed, others)
    stated = temperature_file(folder)
    files = [*(path for path in listed(place) if path.is_file()), *([stated] if is_there(stated) else [])]
    masks, about, unread = find_masks(folder, posed, (shown.paths, pictures), {})
    return SceneFiles(
        posed, points, shown.paths, pictures, shown.shipped, read_radiometry(stated), files=files,
        notes=[*thermal.notes, *rgb.notes, *notes, *unpaired, *unread], masks=masks, assumed={**assumed, **about},
        model=place,
    )  # fmt: skip


def model_folders(folder: Path, places: Iterable[str]) -> list[Path]:
    """Return the first of `places` that is a folder; for `0`, all of COLMAP's numbered models there."""
    for place in (folder / name for name in places):
        numbered = listed(place.parent) if place.name == "0" and is_folder(place.parent) else []
        numbered = [path for path in numbered if path.name.isdecimal() and is_folder(path)]
        if numbered or is_folder(place):
            return sorted(numbered, key=lambda path: int(path.name)) or [place]
    return []


def _chosen_model(
    folder: Path, places: Iterable[str], title: str, thermal: Images, modality: tuple[str, str]
) -> tuple[Path, list[ImageEntry] | None, dict[str, str], list[str]]:
    """Return the folder of the model that poses most thermal images, its images if read, what is assumed, notes."""
    found = model_folders(folder, places)
    if not found:
        first = next(iter(places))
        raise SceneError(
            f"{folder} has no COLMAP model in {first}; find poses first: tdgbench data prepare does, or COLMAP on its "
            f"images (read as {title})"
        )
    models = [path for path in found if is_there(path / "images.bin") or is_there(path / "images.txt")]
    if len(models) < 2:
        return (models or found)[0], None, {}, []
    entries, counts = [read_images(path) for path in models], []
    for path, images in zip(models, entries, strict=True):
        names = view_names(of_modality([key(image.name) for image in images], *modality), str(path))
        counts.append(len(pair(thermal.paths, {name: one for one, name in names.items()}, str(folder))))
    number = counts.index(max(counts))
    best = models[number]
    name = best.relative_to(folder).as_posix()
    sizes = ", ".join(f"{path.name}: {count}" for path, count in zip(models, counts, strict=True))
    said = f"{name}: {max(counts)} of {len(thermal.paths)} thermal images, of {len(models)} models ({sizes})"
    why = f"{said}: each has a world of its own, and the largest is read; to read another one, remove or rename {name}"
    return best, entries[number], {"model": said}, [why] if number else []


def _registered_pairs(
    folder: Path, rgb: Images, posed: Mapping[str, RegisteredImage], others: Mapping[str, RegisteredImage]
) -> tuple[dict[str, Path], list[str]]:
    """Return RGB images by view, and notes. others: images that COLMAP posed beside the thermal ones.

    An RGB image whose pose or lens is another one is no registered pair.
    """
    files, in_others = (pair(rgb.paths, _keys(some), f"{folder}: RGB") for some in (posed, others))
    own = {file: others[name] for name, file in in_others.items()}
    apart = {view for view, file in files.items() if others and not _same_camera(own.get(file), posed[view])}
    notes = [
        f"{len(apart)} RGB images have no pose and lens in the model that equal the thermal image's, so they are no "
        f"registered pairs and are not used: {first_few(apart)}; warp them into the thermal camera to use them"
    ]
    return {view: rgb.paths[file] for view, file in files.items() if view not in apart}, notes if apart else []


def _same_camera(one: RegisteredImage | None, other: RegisteredImage) -> bool:
    return (
        one is not None
        and one.lens == other.lens
        and np.allclose(one.camera.world_to_camera, other.camera.world_to_camera, rtol=0, atol=SAME_POSE)
    )


def find_images(folder: Path, suffixes: tuple[str, ...] = SUFFIXES) -> Images:
    """Find images below a folder, also in its subfolders, by key; none without the folder.

    suffixes: in lower case; a file's may be in upper case. Hidden files, and masks beside images, are passed over.
    Raises SceneError for a name that no result could have, two files of one key, and what is no regular file.
    """
    if not is_there(folder):
        return Images({}, {}, [])
    if not is_folder(folder):
        raise SceneError(f"{folder} is no folder; replace it by a folder of images, or remove it")
    paths: dict[str, Path] = {}
    shipped: dict[str, str] = {}
    unread: list[str] = []
    for top in [name for name in SPLITS if is_folder(folder / name)] or [""]:
        for path in _files_below(folder / top, suffixes, set()):
            name = path.relative_to(folder / top).as_posix()
            if path.suffix.lower() not in suffixes:
                unread.append(name)
                continue
            one = key(name)
            check_view_name(key(path.name), f"{path.parent}: the file {path.name!r}")
            if paths.setdefault(one, regular_file(path)) != path:
                raise SceneError(f"{path} and {paths[one]} are both view {one}; keep one of them")
            shipped |= {one: top} if top else {}
    stems = {path.with_suffix("") for path in paths.values()}
    beside = {one for one, path in paths.items() if path.name.startswith(DYNAMIC)
              and path.with_name(path.stem.removeprefix(DYNAMIC)) in stems}  # fmt: skip
    paths = {one: path for one, path in paths.items() if one not in beside}
    return Images(paths, shipped, about_unread(f"{folder.name}/", unread, paths))


def _files_below(folder: Path, suffixes: tuple[str, ...], above: set[Path]) -> Iterator[Path]:
    """Yield files below a folder, sorted; what is named as an image is one. above: real folders around it."""
    real = folder.resolve()
    for path in listed(folder):
        if path.name.startswith("."):
            continue
        if path.suffix.lower() not in suffixes and is_folder(path):
            if path.resolve() not in above | {real}:
                yield from _files_below(path, suffixes, above | {real})
        else:
            yield path


def by_view(folder: Path, images: Images, posed: Mapping[str, RegisteredImage]) -> Images:
    """Return images by view name; images without a pose by key. folder: of the scene. Raises SceneError."""
    views = {file: view for view, file in pair(images.paths, _keys(posed), str(folder)).items()}
    paths: dict[str, Path] = {}
    for file, path in images.paths.items():
        name = views.get(file, file)
        if paths.setdefault(name, path) != path:
            raise SceneError(f"{paths[name]} and {path} are both view {name}; keep one of them")
    return Images(paths, {views.get(file, file): part for file, part in images.shipped.items()}, images.notes)


def find_masks(
    folder: Path, posed: Mapping[str, RegisteredImage], images: Iterable[Mapping[str, Path]], stated: Mapping[str, Path]
) -> tuple[dict[str, Mask], dict[str, str], list[str]]:
    """Return masks by view name, what is assumed, and notes on files. Raises SceneError for two masks of a view.

    images: by view name, beside which masks may lie. stated: masks that a file names, by view name.
    """
    found = [("mask_path: black hides", view, Mask(path)) for view, path in stated.items()]
    elsewhere = {*stated.values()}
    inside = find_images(folder / MASKS).paths
    read = {*inside.values()}
    files = _files_below(folder / MASKS, SUFFIXES, set()) if is_there(folder / MASKS) else ()
    unread = [path.name for path in files if path not in read]
    paths = {one: path for one, path in inside.items() if path not in elsewhere}
    for is_double in (False, True):  # 1.png, and 1.png.png of 1.png
        part = {key(one): path for one, path in paths.items() if (key(one) != one) == is_double}
        of_views = by_view(folder, Images(part, {}, []), posed).paths
        found += [(f"{MASKS}/: black hides", view, Mask(path)) for view, path in of_views.items()]
    for view, image in (one for part in images for one in part.items()):
        if is_there(beside := image.with_name(f"{DYNAMIC}{image.stem}.png")):
            found.append((f"{DYNAMIC}*.png: what is not black hides", view, Mask(beside, inverted=True)))
    masks: dict[str, Mask] = {}
    for _, view, mask in found:
        if masks.setdefault(view, mask) != mask:
            raise SceneError(f"{mask.path} and {masks[view].path} are both masks of view {view}; keep one of them")
        regular_file(mask.path)
    counts = Counter(source for source, _, _ in found)
    said = "; ".join(f"{source} ({count} files)" for source, count in counts.items())
    lost = [f"{MASKS}/ holds {len(unread)} files that are not read ({first_few(unread)})"] if unread else []
    return masks, {MASKS: said} if said else {}, lost


def _keys(posed: Mapping[str, RegisteredImage]) -> dict[str, str]:
    return {view: image.key for view, image in posed.items()}

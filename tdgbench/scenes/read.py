"""Turn what a layout found in a folder into a scene."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from tdgbench.scenes.camera import Camera, check_camera
from tdgbench.scenes.colmap import RegisteredImage
from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.formats import Header, header
from tdgbench.scenes.geometry import judged
from tdgbench.scenes.images import read_image, resize, with_channels
from tdgbench.scenes.inputs import hash_of, is_folder, is_there, read_array, regular_file
from tdgbench.scenes.layouts import LAYOUTS, Layout, SceneFiles, detect
from tdgbench.scenes.layouts.layout import by_view, find_images
from tdgbench.scenes.names import in_case_alone
from tdgbench.scenes.options import Description, ReadOptions, split_names
from tdgbench.scenes.registry import origin_of, sensor_of
from tdgbench.scenes.scene import Scene, View
from tdgbench.scenes.thermal import RAW_IMAGES, ThermalRequest, thermal_images
from tdgbench.scenes.view_images import ImageSource, ThermalImages, native_camera, resample
from tdgbench.text import first_few

DEPTH, TRUE = "depth", "temperature"  # folders of true depth and true temperatures, of synthetic scenes


@dataclass(frozen=True)
class Outline:
    """A scene whose images have not been decoded.

    scene: without what only images tell: channels are 0, temperature is None, views have neither images nor masks.
    read: returns the complete scene; raises SceneError.
    """

    scene: Scene
    read: Callable[[], Scene]


def outline_scene(folder: Path, description: Description, options: ReadOptions, layout: Layout | None) -> Outline:
    """Read the scene in a folder, without decoding images. layout: None detects it, which `assumed` says.

    Raises SceneError naming the file or view and the remedy.
    """
    detected = layout is None
    layout = layout or detect(folder)
    if layout is None:
        looks = "; ".join(f"{known.title}: {known.looks}" for known in LAYOUTS.values())
        raise SceneError(f"{folder} has none of the layouts of a scene ({looks}); see docs/data.md")
    scene_files = layout.find(folder)
    thermal = _radiometric_files(folder, scene_files) if options.thermal == "radiometric" else scene_files.thermal
    names, notes = _paired(folder, scene_files.posed, thermal)
    train, test, left_out = _split(folder, names, options.split, scene_files.shipped)
    names, masks, rgb = sorted([*train, *test]), scene_files.masks, scene_files.rgb
    sources, photos, views, truth = {}, {}, {}, list[Path]()
    kinds = (DEPTH, TRUE) if (origin := origin_of(folder)) else ()  # of captures, nobody knows whose these are
    notes += [
        f"{kind}/ is not read: only built-in scenes have true values there"
        for kind in (DEPTH, TRUE) if not origin and is_folder(folder / kind)
    ]  # fmt: skip
    for name in names:
        found, posed = _header(thermal[name], options.thermal == "shown"), scene_files.posed[name]
        camera = _camera(posed, found, options)
        source = sources[name] = ImageSource(thermal[name], posed, camera.width, camera.height, masks.get(name), found)
        if name in rgb:
            photos[name] = replace(source, path=rgb[name], mask=None, header=_header(rgb[name], as_picture=True))
        known = {kind: folder / kind / f"{name}.npy" for kind in kinds}
        known = {kind: regular_file(path) for kind, path in known.items() if is_there(path)}
        truth += known.values()
        views[name] = _make_view(source, camera, photos.get(name), known)
    if useless := sorted(masks.keys() - {*names}):
        left_out.append(f"{len(useless)} masks belong to no view and are not used: {first_few(useless)}")
    hiding = [mask.path for mask in masks.values()]
    files = [*thermal.values(), *rgb.values(), *hiding, *scene_files.files, *truth]
    hashes = {path: hash_of(path) for path in sorted({*files})}  # whose errors name the file
    doubts = _doubted_copies(folder, [thermal[name] for name in train], [thermal[name] for name in test], hashes)
    scene = Scene(
        description.scene, description.dataset, description.group,
        train=[views[n] for n in train], test=[views[n] for n in test], points=scene_files.points, temperature=None,
        split=options.split, fingerprint=_fingerprint(folder, hashes), channels=0,
        notes=[*scene_files.notes, *notes, *left_out], folder=folder, model=scene_files.model, doubts=doubts,
        assumed={
            **({"layout": f"{layout.title}: {layout.looks}"} if detected else {}),
            **origin, **sensor_of(description.dataset, description.scene),
            **scene_files.assumed, **_about_images(sources, photos, options), **_about_lenses(sources.values()),
        },
    )  # fmt: skip
    scene = judged(scene)
    request = ThermalRequest(description.scene, sources, train, options, scene_files.radiometry)
    read = scene_files.read_thermal or thermal_images
    return Outline(scene, lambda: _with_images(scene, read(request)))


def _with_images(scene: Scene, images: ThermalImages) -> Scene:
    def whole(view: View) -> View:
        image, valid = images.images[view.name]
        return replace(view, load_thermal=lambda: image, load_valid=None if valid is None else lambda: valid)

    return replace(
        scene, train=[whole(view) for view in scene.train], test=[whole(view) for view in scene.test],
        temperature=images.temperature, raw_count_range=images.raw_count_range, channels=images.channels,
        notes=[*scene.notes, *images.notes], assumed={**scene.assumed, **images.assumed},
        doubts=[*scene.doubts, *images.doubts],
    )  # fmt: skip


def _radiometric_files(folder: Path, scene_files: SceneFiles) -> dict[str, Path]:
    """Return files with temperatures, by view name: the cameras' own, unless the layout has read_thermal."""
    if scene_files.read_thermal is not None:
        return scene_files.thermal
    if not is_folder(folder / RAW_IMAGES):
        raise SceneError(
            f"{folder} has no {RAW_IMAGES}/ folder of radiometric files, which data.thermal=radiometric reads; add it, "
            "or use data.thermal=shown"
        )
    raw = by_view(folder, find_images(folder / RAW_IMAGES), scene_files.posed).paths
    if not set(raw) & set(scene_files.thermal):
        raise SceneError(
            f"{folder / RAW_IMAGES} and the thermal images have no view in common ({sorted(raw)[:2]}, "
            f"{sorted(scene_files.thermal)[:2]}); rename the radiometric files after the views, or use "
            "data.thermal=shown"
        )
    return raw


def _paired(
    folder: Path, posed: Mapping[str, RegisteredImage], thermal: Mapping[str, Path]
) -> tuple[list[str], list[str]]:
    """Return names of the views with a pose and a thermal image, and notes on the others."""
    names = sorted(posed.keys() & thermal.keys())
    unposed, unpaired = sorted(thermal.keys() - posed.keys()), sorted(posed.keys() - thermal.keys())
    alike = in_case_alone(unposed, unpaired)
    if not names:
        some = f"thermal: {unposed[:2]}, poses: {unpaired[:2]}; rename the images as the poses name them"
        why = f"in case alone differ {alike}; rename them" if alike else some
        raise SceneError(f"{folder}: no thermal image has the name of a view with a pose ({why})")
    notes = [f"thermal images without a pose may be views in another case: {alike}; rename them"] if alike else []
    if unposed:
        notes.append(f"{len(unposed)} thermal images have no pose and are omitted: {first_few(unposed)}")
    if unpaired:
        notes.append(f"{len(unpaired)} posed views have no thermal image and are omitted: {first_few(unpaired)}")
    return names, notes


def _split(
    folder: Path, names: list[str], how: str, shipped: Mapping[str, str]
) -> tuple[list[str], list[str], list[str]]:
    """Return names of training and of test views, and notes. As shipped, views that are in neither part are omitted."""
    unplaced = [name for name in names if name not in shipped] if how == "folder" and shipped else []
    said = f"{len(unplaced)} views are in no part of the shipped split and are omitted: {first_few(unplaced)}"
    try:
        train, test = split_names([name for name in names if name not in {*unplaced}], how, shipped)
    except ValueError as error:
        raise SceneError(f"{folder}: {error}") from error
    return train, test, [said] if unplaced else []


def _header(path: Path, as_picture: bool) -> Header | None:
    """Return what a thermal file says of its pixels; None if it cannot be read, which decoding it says."""
    try:
        return header(path, as_picture)
    except SceneError:
        return None


def _camera(posed: RegisteredImage, found: Header | None, options: ReadOptions) -> Camera:
    """Return the camera of a view's images: of the size that the thermal image has, or is resized to."""
    camera = native_camera(posed, None if found is None else (found.width, found.height))
    if options.principal_point == "center":
        K = camera.K.copy()
        K[:2, 2] = camera.width / 2, camera.height / 2
        camera = replace(camera, K=K)
    if options.width is None:
        return camera
    camera = camera.resized(options.width, max(1, round(camera.height * options.width / camera.width)))
    return check_camera(camera, f"data.width={options.width}: view {posed.name}")


def _about_images(
    sources: Mapping[str, ImageSource], photos: Mapping[str, ImageSource], options: ReadOptions
) -> dict[str, str]:
    """Return which pixels files have, what they are resampled to and by what, and which statements are ignored."""
    headers, of_photos = ([one.header for one in some.values() if one.header] for some in (sources, photos))
    native = _listed({(one.width, one.height) for one in headers})
    cameras = _listed({source.posed.source_size for source in sources.values()})
    used = _listed({(source.width, source.height) for source in sources.values()})
    by = "area average to shrink, bilinear to grow"
    size = f"{native} px, as the files have"
    if native != cameras:
        size += f"; cameras are of {cameras} px, and their intrinsics follow the images"
    if options.width is not None:
        size += f"; resized to {used} px (data.width): {by}"
    said = {"size": size, "depth": first_few(sorted({f"{one.depth} {one.format}" for one in headers}))}
    if photos and _listed({(one.width, one.height) for one in of_photos}) != used:
        said["rgb"] = f"{_listed({(one.width, one.height) for one in of_photos})} px, resampled to {used} px: {by}"
    for name, some in (("pixels", headers), ("rgb_pixels", of_photos)):
        if stated := dict.fromkeys(line for one in some for line in one.assumed):
            said[name] = "; ".join(stated)
    return said


def _listed(sizes: set[tuple[int, int]]) -> str:
    return first_few([f"{width}×{height}" for width, height in sorted(sizes)])


def _about_lenses(sources: Iterable[ImageSource]) -> dict[str, str]:
    """Return the lenses whose distortion is removed; nothing for pinholes."""
    lenses = {source.posed.undistortion.source.model_name for source in sources if source.posed.undistortion}
    return {"lens": f"{', '.join(sorted(lenses))}: distortion removed, bilinear"} if lenses else {}


def _make_view(source: ImageSource, camera: Camera, photo: ImageSource | None, truth: Mapping[str, Path]) -> View:
    """Return a view without its thermal image and mask."""
    depth, degC = truth.get(DEPTH), truth.get(TRUE)
    return View(
        source.posed.name, camera, partial(_refuse, source.posed.name),
        load_rgb=None if photo is None else partial(_load_rgb, photo), thermal_path=source.path,
        is_undistorted=source.posed.undistortion is not None,
        load_true_depth=None if depth is None else partial(_read_map, depth, "depth map", camera),
        load_true_temperature=None if degC is None else partial(_read_map, degC, "map of temperatures", camera),
    )  # fmt: skip


def _read_map(path: Path, what: str, camera: Camera) -> np.ndarray:
    """Return finite numbers (H, W) of an .npy file, resized as the images are. Raises SceneError, saying what they are.

    A map of another aspect ratio keeps its size: it belongs to another camera, and what needs it says so.
    """
    values = read_array(path)
    if values.ndim != 2 or not np.isfinite(values).all():
        raise SceneError(f"{path} is no {what}: it must hold finite numbers of shape (H, W)")
    height, width = values.shape
    if values.shape == (camera.height, camera.width) or abs(camera.width * height / width - camera.height) > 1:
        return values
    return resize(values[..., None].astype(np.float32), camera.width, camera.height)[..., 0]


def _refuse(name: str) -> np.ndarray:
    raise SceneError(f"the thermal image of view {name} has not been read: this is an outline of its scene")


def _load_rgb(source: ImageSource) -> np.ndarray:
    image, _ = resample(read_image(source.path), None, source)
    return np.ascontiguousarray(with_channels(image, 3), np.float32)


def _fingerprint(folder: Path, hashes: Mapping[Path, bytes]) -> str:
    """Return the hash of the paths and contents of the files. hashes: of contents, sorted by path."""
    digest = hashlib.sha256()
    for path, content in hashes.items():
        digest.update(f"{path.relative_to(folder).as_posix()}\0".encode() + content)
    return digest.hexdigest()[:16]


def _doubted_copies(folder: Path, train: list[Path], test: list[Path], hashes: Mapping[Path, bytes]) -> list[str]:
    """Return doubts about thermal images that are equal, of both parts of the split and of one."""
    trained, tested = ({hashes[path]: path for path in part} for part in (train, test))
    both, found = sorted(trained.keys() & tested.keys(), key=tested.__getitem__), list[str]()
    if both:
        first, other = (paths[both[0]].relative_to(folder).as_posix() for paths in (tested, trained))
        which = f"{len(both)} of the test views' thermal images are also those of training views ({first} is {other})"
        found.append(f"{which}, so scores are of what is trained on")
    if copies := {*train, *test} - {*trained.values(), *tested.values()}:
        named = first_few(path.relative_to(folder).as_posix() for path in copies)
        found.append(f"{len(copies)} of the thermal images are copies of others: {named}")
    return [f"{doubt}; delete the copies" for doubt in found]

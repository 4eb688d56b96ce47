"""Structure from motion: COLMAP through pycolmap, on the CPU, from one seed."""

from __future__ import annotations

import itertools
import shutil
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import pycolmap

from tdgbench.data.folders import Stages
from tdgbench.data.prepare.calibration import FOCALS, start_camera
from tdgbench.data.prepare.places import nearest_pairs, to_metres
from tdgbench.data.progress import step
from tdgbench.scenes import PointCloud, SceneError
from tdgbench.scenes.colmap.tables import CameraEntry
from tdgbench.scenes.inputs import listed
from tdgbench.scenes.modalities import LABELS

CameraModel = Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"]
Matching = Literal["exhaustive", "sequential", "nearest"]
CAMERA_MODELS: tuple[str, ...] = get_args(CameraModel)
LARGE = 10  # images of a model whose focal length must agree with others, as of COLMAP's smallest models
LARGEST_RATIO = 2  # times, of these focal lengths
MOST_OFF = 1.15  # times, of the focal length and that of EXIF data
FEWEST_IMAGES = 3  # of a model: two training views and a test view
OVERLAP = 10  # neighbours that an image is matched with in sequential matching, as in COLMAP
PAIRS_AT_A_TIME = 64  # between two steps of the progress
DATABASE = "database.db"


@dataclass(frozen=True)
class SfmOptions:
    """Options of COLMAP. One camera is shared by all images.

    images: which ones COLMAP sees. focal: focal length in px; None: estimated. calibration: of the lens, or of
    several. refine: COLMAP begins with these; else they are kept. is_of_exif: the focal length is that of EXIF data.
    threads: None for all processors.
    """

    images: Literal["rgb", "thermal"] = "rgb"
    focal: float | None = None
    matching: Matching = "exhaustive"
    camera_model: CameraModel = "SIMPLE_RADIAL"
    seed: int = 0
    threads: int | None = None
    calibration: tuple[CameraEntry, ...] = ()
    refine: bool = False
    is_of_exif: bool = False


@dataclass(frozen=True)
class Structure:
    """The largest model, or known poses. poses: world-to-camera (4, 4) by image file.

    error_px: mean reprojection error, None without matches. models: registered images of each model found. features,
    matches: by image file, keypoints and verified matches with all other images. notes: for the report. is_in_metres:
    z is up then, too.
    """

    camera: pycolmap.Camera
    poses: dict[str, np.ndarray]
    points: PointCloud
    error_px: float | None
    models: list[int]
    features: Counter[str]
    matches: Counter[str]
    notes: list[str] = field(default_factory=list)
    is_in_metres: bool = False


def reconstruct(
    images: Path, names: list[str], stages: Stages, options: SfmOptions, positions: np.ndarray | None = None
) -> Structure:
    """Run COLMAP on images of one size. images: their folder; names: their files; stages: what is done already.

    positions: of nearest matching, (N, 3) in m, which the model is aligned with.
    Raises SceneError if no model is found, with what was found instead.
    """
    with quiet():
        database = matched(images, names, stages, options, positions)
        models, notes = _mapped(database, images, names, stages, options)
        keypoints, matches = counts(database)
        sizes = [model.num_reg_images() for model in models]
        if not sizes or sizes[0] < FEWEST_IMAGES:
            raise SceneError(_no_model(names, keypoints, matches, sizes, options.images))
        _check_focal_lengths(models)
        pycolmap.set_random_seed(options.seed)
        best = models[0]
        posed = {image.name for image in best.images.values() if image.has_pose}
        if lost := {image.name for model in models[1:] for image in model.images.values() if image.has_pose} - posed:
            notes.append(
                f"{len(lost)} images are of smaller models, in worlds of their own, and are left out; if they share "
                "images, colmap model_merger joins them: give the result as --poses"
            )
    is_in_metres = False
    if positions is not None:
        note, is_in_metres = to_metres(best, dict(zip(names, positions, strict=True)), options.seed)
        notes.append(note)
    placed = [image for image in best.images.values() if image.has_pose]
    poses = {image.name: np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]]) for image in placed}
    (lens,) = {image.camera_id: best.cameras[image.camera_id] for image in best.images.values()}.values()
    error = best.compute_mean_reprojection_error()
    return Structure(lens, poses, cloud(best), error, sizes, keypoints, matches, notes, is_in_metres)


def _mapped(
    database: Path, images: Path, names: list[str], stages: Stages, options: SfmOptions
) -> tuple[list[pycolmap.Reconstruction], list[str]]:
    """Return the models of a database, largest first, and notes for the report.

    Flat ground seen from above does not settle the focal length, which then runs away: that of EXIF data is kept.
    """

    def models(stage: str, options: SfmOptions) -> list[pycolmap.Reconstruction]:
        place = stages.make(stage, options.refine, lambda part: _map(database, images, part, len(names), options))
        return sorted(map(pycolmap.Reconstruction, listed(place)), key=lambda model: -model.num_reg_images())

    found = models("models", options)
    if not found or not options.is_of_exif or options.focal is None:
        return found, []
    focal = next(iter(found[0].cameras.values())).mean_focal_length()
    if 1 / MOST_OFF < focal / options.focal < MOST_OFF:
        return found, []
    note = (
        f"that is kept: from there, the images lead to {focal:.0f} px, as on flat ground seen from above; "
        f"--focal {focal:.0f} takes this instead"
    )
    return models("kept", replace(options, refine=False)), [note]


def matched(
    images: Path, names: list[str], stages: Stages, options: SfmOptions, positions: np.ndarray | None = None
) -> Path:
    """Return the database of images, with features, matches and the camera of the options. Arguments as above."""
    pairs = list(image_pairs(names, options.matching) if positions is None else nearest_pairs(names, positions))
    inputs = pairs, options.camera_model, options.focal, options.calibration, options.seed
    features = stages.make("features", names, lambda place: _extract(place, images, names, options))
    place = stages.make("matches", inputs, lambda place: _set_camera(features, place, options))
    _match(place / DATABASE, pairs, options)
    return place / DATABASE


def _extract(place: Path, images: Path, names: list[str], options: SfmOptions) -> None:
    settings = pycolmap.FeatureExtractionOptions()
    settings.num_threads = options.threads or -1
    with step("features of images", len(names)) as count:
        mode, device = pycolmap.CameraMode.SINGLE, pycolmap.Device.cpu
        pycolmap.extract_features(place / DATABASE, images, names, mode, extraction_options=settings, device=device)
        count(len(names))


def _set_camera(features: Path, place: Path, options: SfmOptions) -> None:
    """Copy the database, and give it the camera of the options. Its focal length, unless known, is COLMAP's guess."""
    shutil.copyfile(features / DATABASE, place / DATABASE)
    with pycolmap.Database.open(place / DATABASE) as stored:
        (old,) = stored.read_all_cameras()
        size = old.width, old.height
        known = start_camera(size, options.camera_model, options.focal, options.calibration)
        guess = pycolmap.Camera.create_from_model_name(1, options.camera_model, old.mean_focal_length(), *size)
        new = guess if known is None else known
        new.camera_id = old.camera_id
        new.has_prior_focal_length = known is not None or old.has_prior_focal_length
        stored.update_camera(new)


def _match(database: Path, pairs: list[tuple[str, str]], options: SfmOptions) -> None:
    """Match pairs. COLMAP stores each when it is verified, and those that are stored already stay."""
    settings = pycolmap.FeatureMatchingOptions()
    settings.num_threads = options.threads or -1
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    pairing = pycolmap.ImportedPairingOptions()
    list_path = database.with_name("pairs.txt")
    pairing.match_list_path = str(list_path)
    with pycolmap.Database.open(database) as stored:
        ids = {image.name: image.image_id for image in stored.read_all_images()}
        missing = [(a, b) for a, b in pairs if not stored.exists_two_view_geometry(ids[a], ids[b])]
    if not missing:
        return
    with step("pairs of images to match", len(missing)) as count:
        for first in range(0, len(missing), PAIRS_AT_A_TIME):
            some = missing[first : first + PAIRS_AT_A_TIME]
            list_path.write_text("".join(f"{a} {b}\n" for a, b in some), encoding="utf-8")
            pycolmap.match_image_pairs(database, settings, pairing, verification, pycolmap.Device.cpu)
            count(first + len(some))


def image_pairs(names: list[str], matching: str) -> Iterator[tuple[str, str]]:
    """Yield pairs of images to match: all of them, or each with its next neighbours by name, and those 2, 4, 8 … away.

    >>> list(image_pairs(["a", "b", "c"], "exhaustive"))
    [('a', 'b'), ('a', 'c'), ('b', 'c')]
    """
    if matching == "exhaustive":
        yield from itertools.combinations(names, 2)
        return
    steps = sorted({*range(1, OVERLAP + 1), *(2**i for i in range(OVERLAP))})
    for index, name in enumerate(names):
        yield from ((name, names[index + away]) for away in steps if index + away < len(names))


def pipeline(options: SfmOptions) -> pycolmap.IncrementalPipelineOptions:
    settings = pycolmap.IncrementalPipelineOptions()
    settings.random_seed = settings.mapper.random_seed = settings.triangulation.random_seed = options.seed
    settings.num_threads = settings.mapper.num_threads = options.threads or -1
    settings.min_model_size = FEWEST_IMAGES
    settings.ba_refine_focal_length = options.refine or (options.focal is None and not options.calibration)
    settings.ba_refine_extra_params = options.refine or not options.calibration
    return settings


def _map(database: Path, images: Path, folder: Path, total: int, options: SfmOptions) -> None:
    pycolmap.set_random_seed(options.seed)
    with step("images to register", total) as count:
        done = itertools.count(3)  # the first pair counts as two
        pycolmap.incremental_mapping(
            database,
            images,
            folder,
            pipeline(options),
            initial_image_pair_callback=lambda: count(2),
            next_image_callback=lambda: count(min(next(done), total)),
        )


def _check_focal_lengths(models: list[pycolmap.Reconstruction]) -> None:
    """Raise SceneError for focal lengths that no lens has, or that differ between large models of one camera."""
    large = [model for model in models if model.num_reg_images() >= min(LARGE, models[0].num_reg_images())]
    cameras = [camera for model in large for camera in model.cameras.values()]
    focals, width = sorted(camera.mean_focal_length() for camera in cameras), cameras[0].width
    if focals[0] < FOCALS[0] * width or focals[-1] > min(FOCALS[1] * width, LARGEST_RATIO * focals[0]):
        raise SceneError(
            f"COLMAP finds focal lengths of {', '.join(f'{focal:.0f}' for focal in focals)} px, as no lens has, in "
            f"images {width} px wide: views in one direction on a flat field do not settle it; say it: --focal PX"
        )


def counts(database: Path) -> tuple[Counter[str], Counter[str]]:
    """Return keypoints, and verified matches with all other images, by image file."""
    features: Counter[str] = Counter()
    matches: Counter[str] = Counter()
    with pycolmap.Database.open(database) as stored:
        names = {image.image_id: image.name for image in stored.read_all_images()}
        for image_id, name in names.items():
            features[name] = stored.num_keypoints_for_image(image_id)
        for pair_id, inliers in zip(*stored.read_two_view_geometry_num_inliers(), strict=True):
            for image_id in pycolmap.pair_id_to_image_pair(pair_id):
                matches[names[image_id]] += inliers
    return features, matches


def _no_model(names: list[str], features: Counter[str], matches: Counter[str], sizes: list[int], images: str) -> str:
    counts, verified = [features[name] for name in names], [matches[name] for name in names]
    found = f"models of {', '.join(map(str, sizes))} images" if sizes else "no model"
    matched = f"{min(verified)} to {max(verified)}" if max(verified) else "no"
    return (
        f"COLMAP finds {found} in {len(names)} {LABELS[images]} images, and a scene needs one of {FEWEST_IMAGES}: the "
        f"images have {min(counts)} to {max(counts)} features and {matched} verified matches "
        "each. Take more pictures that overlap by two thirds, from moving positions, of something with texture"
    )


def cloud(model: pycolmap.Reconstruction) -> PointCloud:
    points = [model.points3D[key] for key in sorted(model.points3D)]
    colors = np.array([point.color for point in points], np.float32).reshape(-1, 3) / np.float32(255)
    return PointCloud(np.array([point.xyz for point in points], np.float64).reshape(-1, 3), colors)


@contextmanager
def quiet() -> Iterator[None]:
    """Silence COLMAP's log; errors are exceptions, or said in words of this program."""
    before = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    try:
        yield
    finally:
        pycolmap.logging.minloglevel = before

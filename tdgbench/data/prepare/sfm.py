"""Structure from motion: COLMAP through pycolmap, on the CPU, from one seed."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
import pycolmap
from PIL import Image
from pydantic import Field

from tdgbench.data.progress import step
from tdgbench.scenes import PointCloud, SceneError
from tdgbench.scenes.colmap import quiet

CameraModel = Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"]
CAMERA_MODELS: tuple[str, ...] = get_args(CameraModel)
FEWEST_IMAGES = 3  # of a model: two training views and a test view
OVERLAP = 10  # neighbours that an image is matched with in sequential matching, as in COLMAP
FOCALS = 0.4, 10.0  # of a lens, × the image's width: 103° to 6°
KINDS = {"rgb": "RGB", "thermal": "thermal"}  # of images, in words
PAIRS_AT_A_TIME = 64  # between two steps of the progress


@dataclass(frozen=True)
class SfmOptions:
    """Options of COLMAP. One camera is shared by all images.

    images: which ones COLMAP sees. focal: focal length in px, which is kept; None: estimated. threads: None for all
    processors.
    """

    images: Literal["rgb", "thermal"] = "rgb"
    focal: Annotated[float, Field(gt=0)] | None = None
    matching: Literal["exhaustive", "sequential"] = "exhaustive"
    camera_model: CameraModel = "SIMPLE_RADIAL"
    seed: Annotated[int, Field(ge=0)] = 0
    threads: Annotated[int, Field(ge=1)] | None = None


@dataclass(frozen=True)
class Structure:
    """The largest model. poses: world-to-camera (4, 4) by image file. error_px: mean reprojection error.

    models: registered images of each model found. features, matches: by image file, keypoints and verified matches
    with all other images.
    """

    camera: pycolmap.Camera
    poses: dict[str, np.ndarray]
    points: PointCloud
    error_px: float
    models: list[int]
    features: Counter[str]
    matches: Counter[str]


def reconstruct(images: Path, names: list[str], work: Path, options: SfmOptions) -> Structure:
    """Run COLMAP on images of one size. images: their folder; names: their files; work: an empty folder.

    Raises SceneError if no model is found, with what was found instead.
    """
    database = work / "database.db"
    with quiet():
        pycolmap.set_random_seed(options.seed)
        _extract(database, images, names, options)
        _match(database, work / "pairs.txt", names, options)
        models = _map(database, images, work / "models", len(names), options)
    features, matches = _counts(database)
    sizes = sorted((model.num_reg_images() for model in models), reverse=True)
    if not sizes or sizes[0] < FEWEST_IMAGES:
        raise SceneError(_no_model(names, features, matches, sizes, options.images))
    best = max(models, key=lambda model: model.num_reg_images())
    poses = {image.name: _pose(image) for image in best.images.values() if image.has_pose}
    (camera,) = {image.camera_id: best.cameras[image.camera_id] for image in best.images.values()}.values()
    focal = camera.mean_focal_length()
    if not FOCALS[0] < focal / camera.width < FOCALS[1]:
        raise SceneError(
            f"COLMAP finds a focal length of {focal:.0f} px for images {camera.width} px wide, as no lens has: views "
            "in one direction on a flat field do not settle it. Say it: --focal PX"
        )
    error = best.compute_mean_reprojection_error()
    return Structure(camera, poses, _cloud(best), error, sizes, features, matches)


def _extract(database: Path, images: Path, names: list[str], options: SfmOptions) -> None:
    settings = pycolmap.FeatureExtractionOptions()
    settings.num_threads = options.threads or -1
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = options.camera_model
    if options.focal is not None:
        width, height = Image.open(images / names[0]).size
        camera = pycolmap.Camera.create_from_model_name(1, options.camera_model, options.focal, width, height)
        reader.camera_params = ",".join(map(str, camera.params))
    with step("features of images", len(names)) as count:
        pycolmap.extract_features(
            database, images, names, pycolmap.CameraMode.SINGLE, reader, settings, pycolmap.Device.cpu
        )
        count(len(names))


def _match(database: Path, list_path: Path, names: list[str], options: SfmOptions) -> None:
    settings = pycolmap.FeatureMatchingOptions()
    settings.num_threads = options.threads or -1
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(list_path)
    pairs = list(image_pairs(names, options.matching))
    with step("pairs of images to match", len(pairs)) as count:
        for first in range(0, len(pairs), PAIRS_AT_A_TIME):
            some = pairs[first : first + PAIRS_AT_A_TIME]
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


def _map(database: Path, images: Path, folder: Path, total: int, options: SfmOptions) -> list[pycolmap.Reconstruction]:
    settings = pycolmap.IncrementalPipelineOptions()
    settings.random_seed = settings.mapper.random_seed = settings.triangulation.random_seed = options.seed
    settings.num_threads = settings.mapper.num_threads = options.threads or -1
    settings.min_model_size = FEWEST_IMAGES
    settings.ba_refine_focal_length = options.focal is None
    folder.mkdir()
    with step("images to register", total) as count:
        done = itertools.count(3)  # the first pair counts as two
        models = pycolmap.incremental_mapping(
            database,
            images,
            folder,
            settings,
            initial_image_pair_callback=lambda: count(2),
            next_image_callback=lambda: count(min(next(done), total)),
        )
    return list(models.values())


def _counts(database: Path) -> tuple[Counter[str], Counter[str]]:
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
    return (
        f"COLMAP finds {found} in {len(names)} {KINDS[images]} images, and a scene needs one of {FEWEST_IMAGES}: the "
        f"images have {min(counts)} to {max(counts)} features and {min(verified)} to {max(verified)} verified matches "
        "each. Take more pictures that overlap by two thirds, from moving positions, of something with texture"
    )


def _pose(image: pycolmap.Image) -> np.ndarray:
    pose = np.eye(4)
    pose[:3] = image.cam_from_world().matrix()
    return pose


def _cloud(model: pycolmap.Reconstruction) -> PointCloud:
    points = [model.points3D[key] for key in sorted(model.points3D)]
    colors = np.array([point.color for point in points], np.float32).reshape(-1, 3) / np.float32(255)
    return PointCloud(np.array([point.xyz for point in points], np.float64).reshape(-1, 3), colors)

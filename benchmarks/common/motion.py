"""COLMAP models of thermal frames through pycolmap, on the CPU: structure from motion, or points of known poses."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap
from PIL import Image

CAMERA_MODEL = "SIMPLE_RADIAL"
STRETCH = (1, 99)  # percentiles over a sequence, which become black and white
MIN_REGISTERED = 0.9  # share of the views
SEED, THREADS = 0, 1


def from_motion(frames: Mapping[str, np.ndarray]) -> pycolmap.Reconstruction:
    """The largest COLMAP model of thermal frames (H, W) by image name; one camera, all pairs matched, on the CPU.

    Ends the program if fewer than MIN_REGISTERED of the frames are in it.
    """
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        database = _matched(frames, work, CAMERA_MODEL, "")
        options = pycolmap.IncrementalPipelineOptions()
        options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = SEED
        options.num_threads = options.mapper.num_threads = THREADS
        (work / "models").mkdir()
        models = pycolmap.incremental_mapping(database, work / "images", work / "models", options)
    best = max(models.values(), key=lambda model: model.num_reg_images(), default=None)
    found = 0 if best is None else best.num_reg_images()
    if best is None or found < MIN_REGISTERED * len(frames):
        sys.exit(f"COLMAP finds the poses of {found} of {len(frames)} views; no scene is made")
    return best


def triangulated(
    frames: Mapping[str, np.ndarray], camera: pycolmap.Camera, poses: Mapping[str, np.ndarray]
) -> pycolmap.Reconstruction:
    """Points of frames (H, W) with known poses. poses: camera-to-world (4, 4), by image name as the frames."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        database = _matched(frames, work, camera.model_name, ",".join(map(repr, camera.params.tolist())))
        model = pycolmap.Reconstruction()
        with pycolmap.Database.open(database) as stored:
            (camera.camera_id,) = (one.camera_id for one in stored.read_all_cameras())
            model.add_camera_with_trivial_rig(camera)
            for image in stored.read_all_images():
                pose = np.linalg.inv(poses[image.name])[:3]
                image = pycolmap.Image(image.name, camera_id=camera.camera_id, image_id=image.image_id)
                model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
        options = pycolmap.IncrementalPipelineOptions()
        options.triangulation.random_seed, options.num_threads = SEED, THREADS
        return pycolmap.triangulate_points(model, database, work / "images", work, options=options)


def summary(model: pycolmap.Reconstruction, views: int) -> str:
    """What a model holds, in a line."""
    (camera,) = model.cameras.values()
    return (
        f"{model.num_reg_images()} of {views} views, {model.num_points3D()} points, "
        f"mean reprojection error {model.compute_mean_reprojection_error():.2f} px, "
        f"f = {camera.mean_focal_length():.0f} px ({camera.model_name})"
    )


def _matched(frames: Mapping[str, np.ndarray], work: Path, camera_model: str, params: str) -> Path:
    """Database of the features and matches of frames, whose images are in `work`/images, stretched alike to 8 bits."""
    images, database = work / "images", work / "database.db"
    images.mkdir()
    low, high = np.percentile(np.concatenate([frame[::4, ::4].ravel() for frame in frames.values()]), STRETCH)
    for name, frame in frames.items():
        shown = np.clip((frame.astype(np.float64) - low) / (high - low), 0, 1)
        Image.fromarray(np.round(255 * shown).astype(np.uint8)).save(images / name)
    pycolmap.logging.minloglevel = pycolmap.logging.Level.ERROR.value
    pycolmap.set_random_seed(SEED)
    reader, extraction = pycolmap.ImageReaderOptions(), pycolmap.FeatureExtractionOptions()
    reader.camera_model, reader.camera_params, extraction.num_threads = camera_model, params, THREADS
    single, cpu = pycolmap.CameraMode.SINGLE, pycolmap.Device.cpu
    pycolmap.extract_features(
        database, images, camera_mode=single, reader_options=reader, extraction_options=extraction, device=cpu
    )
    matching, verification = pycolmap.FeatureMatchingOptions(), pycolmap.TwoViewGeometryOptions()
    matching.num_threads, verification.ransac.random_seed = THREADS, SEED
    pycolmap.match_exhaustive(database, matching_options=matching, verification_options=verification, device=cpu)
    return database

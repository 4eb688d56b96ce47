"""Poses that another program found, of a capture's images; their points are triangulated unless they are shipped."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap

from tdgbench.data.poses.references import Reference
from tdgbench.data.prepare.calibration import start_camera
from tdgbench.data.prepare.capture import Capture
from tdgbench.data.prepare.places import centres_of
from tdgbench.data.prepare.report import Report
from tdgbench.data.prepare.resample import Size
from tdgbench.data.prepare.sfm import FEWEST_IMAGES, SfmOptions, Structure, cloud, counts, matched, pipeline, quiet
from tdgbench.data.prepare.stages import Stages
from tdgbench.data.progress import step
from tdgbench.scenes import PointCloud, SceneError
from tdgbench.scenes.modalities import LABELS

FAR = 100  # × the cameras' extent: an origin that float32 coordinates cannot afford, as of maps


class KnownPoses(NamedTuple):
    """World-to-camera poses (4, 4) by image file, points in their world if these are known, and ids of their lenses."""

    poses: dict[str, np.ndarray]
    points: PointCloud | None
    lens_ids: frozenset[int] = frozenset()

    @property
    def centres(self) -> np.ndarray:
        """Positions of the cameras (N, 3)."""
        return centres_of(self.poses.values())


def known_poses(path: Path, reference: Reference, capture: Capture, report: Report) -> KnownPoses:
    """Return the poses of a capture's images in a file, by view or file name; other views leave the capture.

    Raises SceneError if fewer than three images have one.
    """
    found = {}
    for file in report.files:
        stem = Path(file.file if file.rgb in ("", "inside") else file.rgb).stem
        name = next((name for name in (file.view, stem) if name in reference.poses), None)
        if file.status == "written" and name is not None:
            found[file.view] = name
        elif file.status == "written":
            file.status, file.reason = "not registered", f"{path} has no pose of it"
    if len(found) < FEWEST_IMAGES:
        names, views = (", ".join(list(one)[:2]) for one in (reference.poses, capture.names))
        raise SceneError(
            f"{path} has poses of {len(found)} of {len(capture.names)} images ({names} … against {views} …); "
            f"{FEWEST_IMAGES} are needed. Rename the images as there, without folders and extensions"
        )
    capture.keep(found)
    poses = {name: reference.poses[found[view]] for view, name in capture.names.items()}
    report.assumptions += [f"poses are those of {path}, in its world", *reference.notes]
    if len(found) < len(reference.poses):
        report.assumptions.append(
            f"{len(reference.poses) - len(found)} of its {len(reference.poses)} poses are of no image"
        )
    lens_ids = frozenset(reference.lens_ids[name] for name in found.values() if name in reference.lens_ids)
    return _near_origin(KnownPoses(poses, reference.points, lens_ids), report)


def structure_of(known: KnownPoses, images: Path, size: Size, stages: Stages, options: SfmOptions) -> Structure:
    """Return known poses with their points; without any, or to refine the lens, COLMAP triangulates those of matches.

    images: folder of images of a size. options: with a known lens.
    """
    if known.points is not None and not options.refine:
        camera = start_camera(size, options.camera_model, options.focal, options.calibration)
        assert camera is not None  # the lens is known
        notes = ["points are those of the same file"]
        return Structure(camera, known.poses, known.points, None, [], Counter(), Counter(), notes)
    names, positions = list(known.poses), known.centres if options.matching == "nearest" else None
    with quiet():
        database = matched(images, names, stages, options, positions)
        inputs = options.refine, [pose.tolist() for pose in known.poses.values()]
        place = stages.make("points", inputs, lambda place: _triangulate(database, images, place, known, options))
        model = pycolmap.Reconstruction(place)
    points = cloud(model)
    notes = [f"points are triangulated of matches of {LABELS[options.images]} images at these poses"]
    if not len(points.points):
        notes = ["there are no points, as no matches fit the poses: train with init=mvs_thermal or init=random"]
    (camera,) = model.cameras.values()
    error = model.compute_mean_reprojection_error() if len(points.points) else None
    return Structure(camera, known.poses, points, error, [], *counts(database), notes)


def _triangulate(database: Path, images: Path, folder: Path, known: KnownPoses, options: SfmOptions) -> None:
    """Write a model of the poses with the points of the matches; refine the lens if the options say so."""
    model = pycolmap.Reconstruction()
    with pycolmap.Database.open(database) as stored:
        (camera,) = stored.read_all_cameras()
        model.add_camera_with_trivial_rig(camera)
        for image in stored.read_all_images():
            copy = pycolmap.Image(image.name, camera_id=camera.camera_id, image_id=image.image_id)
            model.add_image_with_trivial_frame(copy, pycolmap.Rigid3d(known.poses[image.name][:3]))
    pycolmap.set_random_seed(options.seed)
    with step("images to triangulate", len(known.poses)) as count:
        found = pycolmap.triangulate_points(
            model, database, images, folder, options=pipeline(options), refine_intrinsics=options.refine
        )
        count(len(known.poses))
    found.write(folder)


def _near_origin(known: KnownPoses, report: Report) -> KnownPoses:
    """Return poses and points about the cameras' middle if the world's origin is far away, as that of a map is."""
    middle, extent = known.centres.mean(axis=0), np.linalg.norm(np.ptp(known.centres, axis=0))
    if np.linalg.norm(middle) <= FAR * extent:
        return known
    report.assumptions.append(
        f"the origin is moved to the cameras' middle, {', '.join(f'{x:.3f}' for x in middle)} there"
    )
    to_world = np.eye(4)
    to_world[:3, 3] = middle
    points = None if known.points is None else replace(known.points, points=known.points.points - middle)
    return known._replace(poses={name: pose @ to_world for name, pose in known.poses.items()}, points=points)

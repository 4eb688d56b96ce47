"""Poses that another program found, of a capture's images; their points are triangulated unless they are shipped."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pycolmap

from tdgbench.data.folders import Stages
from tdgbench.data.poses import Reference
from tdgbench.data.prepare.calibration import start_camera
from tdgbench.data.prepare.capture import Capture
from tdgbench.data.prepare.places import centres_of
from tdgbench.data.prepare.report import Report
from tdgbench.data.prepare.resample import Size
from tdgbench.data.prepare.sfm import FEWEST_IMAGES, SfmOptions, Structure, cloud, counts, matched, pipeline, quiet
from tdgbench.data.progress import step
from tdgbench.scenes import SceneError
from tdgbench.scenes.modalities import LABELS


def known_poses(path: Path, reference: Reference, capture: Capture, report: Report) -> Reference:
    """Return the reference with the poses of a capture's images alone, by image file; other views leave the capture.

    path: of the reference, which names images by view or by file. Raises SceneError if fewer than three have a pose.
    """
    found = {}
    for file in report.written:
        stem = Path(file.file if file.rgb in ("", "inside") else file.rgb).stem
        name = next((name for name in (file.view, stem) if name in reference.poses), None)
        if name is None:
            file.drop("not registered", f"{path} has no pose of it")
        else:
            found[file.view] = name
    if len(found) < FEWEST_IMAGES:
        names, views = (", ".join(list(one)[:2]) for one in (reference.poses, capture.views))
        raise SceneError(
            f"{path} has poses of {len(found)} of {len(capture.views)} images ({names} … against {views} …); "
            f"{FEWEST_IMAGES} are needed. Rename the images as there, without folders and extensions"
        )
    capture.keep(found)
    report.assumptions += [f"poses are those of {path}, in its world", *reference.notes]
    if len(found) < len(reference.poses):
        report.assumptions.append(
            f"{len(reference.poses) - len(found)} of its {len(reference.poses)} poses are of no image"
        )
    names_of = {view.image: found[name] for name, view in capture.views.items()}
    return reference._replace(
        poses={image: reference.poses[name] for image, name in names_of.items()},
        lens_ids={image: reference.lens_ids[name] for image, name in names_of.items() if name in reference.lens_ids},
    )


def structure_of(known: Reference, images: Path, size: Size, stages: Stages, options: SfmOptions) -> Structure:
    """Return known poses with their points; without any, or to refine the lens, COLMAP triangulates those of matches.

    images: folder of images of a size. options: with a known lens.
    """
    if known.points is not None and not options.refine:
        camera = start_camera(size, options.camera_model, options.focal, options.calibration)
        assert camera is not None  # the lens is known
        notes = ["points are those of the same file"]
        return Structure(camera, known.poses, known.points, None, [], Counter(), Counter(), notes)
    names, positions = list(known.poses), centres_of(known.poses.values()) if options.matching == "nearest" else None
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


def _triangulate(database: Path, images: Path, folder: Path, known: Reference, options: SfmOptions) -> None:
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

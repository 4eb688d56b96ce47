"""What cannot be right in cameras and sparse points, whatever file they are from.

Points are judged by a sample, the same one in every run. The limits were tried on the built-in scenes and on 26 public
captures, where no camera stands 1.9 times as far out as nine tenths do, all points have a parallax of 1e-3 radians, and
float32 coordinates move pixels by up to 6e-4 px.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from tdgbench.scenes.camera import Camera
from tdgbench.scenes.outliers import Sight, centers_of, from_middle, sample_of, sight_of
from tdgbench.scenes.scene import Scene, View

MAX_LOST = 0.01  # of the points
LEAST_PARALLAX = 1e-3  # radians; COLMAP keeps points from 0.026 on (filter_min_tri_angle)
FEWEST_SEEN = 50  # points in a typical view, from which a view without any is doubted
MOST_PROJECTED = 2 * 10**7  # points × views that are looked at one by one
ANGLES = 3.0, 150.0  # degrees; a fisheye lens, which sees more, is undistorted to less
STEP = 1.1  # ratio of focal lengths or sizes of two cameras; single images' calibrations differ by 1.05
RESIZED = 0.25  # share of the views below which those of another size, of one lens, look resized
MOST_KINDS = 3  # of cameras in words
MAX_ERROR = 3e-3  # px; trained on facade, 0.003 px cost 0.01 dB, 0.012 px 0.5 dB


def judged(scene: Scene) -> Scene:
    """Return the scene near its origin, with its doubts."""
    scene = near_origin(scene)
    return replace(scene, doubts=[*scene.doubts, *doubts_of(scene)])


def near_origin(scene: Scene) -> Scene:
    """Return the scene with its origin between its cameras if float32 coordinates about the files' are too coarse.

    `assumed` says so, and `origin` is where it lies in the world of the files. Other scenes stay as they are.
    """
    cameras = [view.camera for view in scene.views if view.name not in scene.outliers]
    centers = centers_of(cameras)
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    reach = np.abs(centers - middle).max()
    if 4 * reach > np.abs(centers).max():
        return scene
    error = float(pixel_errors(cameras, sight_of(cameras, sample_of(_points(scene)))).max())
    if error <= MAX_ERROR:
        return scene
    if reach > 0:  # rounded, to be a number that people can use
        middle = np.round(middle, -math.floor(math.log10(reach)))
    to_world = np.eye(4)
    to_world[:3, 3] = middle

    def moved(view: View) -> View:
        return replace(view, camera=replace(view.camera, world_to_camera=view.camera.world_to_camera @ to_world))

    points = scene.points if scene.points is None else replace(scene.points, points=scene.points.points - middle)
    text = (
        f"moved to {', '.join(f'{x:.10g}' for x in middle)} of the files, between the cameras: float32 coordinates "
        f"about the files' origin are {error:.1g} px off"
    )
    return replace(
        scene, train=[moved(view) for view in scene.train], test=[moved(view) for view in scene.test], points=points,
        origin=tuple(middle.tolist()), assumed={**scene.assumed, "origin": text},
    )  # fmt: skip


def pixel_errors(cameras: Sequence[Camera], sight: Sight) -> np.ndarray:
    """Return how far float32 coordinates of the cameras (V,) move what they see, px.

    That is one step of the camera's largest coordinate, at the median depth of the points that the view sees or,
    without any, at the cameras' distance from their middle.
    """
    reach = max(float(np.median(from_middle(cameras))), 1e-9)
    depths = [np.median(z[seen]) if seen.any() else reach for z, seen in zip(sight.z, sight.seen, strict=True)]
    steps = np.spacing(np.abs(centers_of(cameras)).max(axis=1).astype(np.float32))
    return steps * np.array([camera.K[[0, 1], [0, 1]].max() for camera in cameras]) / np.array(depths)


def doubts_of(scene: Scene) -> list[str]:
    """Return what is probably wrong with the scene's cameras and points, a line each, with views and a remedy."""
    outliers, points = scene.outliers, _points(scene)
    views = [view for view in scene.views if view.name not in outliers]
    cameras = [view.camera for view in views]
    sight = sight_of(cameras, sample_of(points))
    found = [_about_outliers(scene), _about_fields_of_view(views), _about_lenses(views)]
    if points is not None and len(points) >= FEWEST_SEEN:
        found += [_about_blind(views, points, sight), _about_lost(cameras, points, sight)]
    errors = pixel_errors(cameras, sight)
    if errors.max() > MAX_ERROR:
        found.append(
            f"view {views[errors.argmax()].name}: float32 coordinates, which models have, move its pixels by "
            f"{errors.max():.1g} px, as the scene is that large; make smaller scenes of it"
        )
    return [doubt for doubt in found if doubt]


def _about_outliers(scene: Scene) -> str:
    out = [view for view in scene.views if view.name in scene.outliers]
    if not out:
        return ""
    names, distances = (view.name for view in scene.views), from_middle([view.camera for view in scene.views])
    farthest = max(away for name, away in zip(names, distances, strict=True) if name in scene.outliers)
    return (
        f"{_named(out)}: the camera stands {farthest:.4g} from the middle of the others and sees nothing that they "
        "see, so it counts in no extent; correct its pose, or remove it from the poses"
    )


def _about_fields_of_view(views: Sequence[View]) -> str:
    """Doubt focal lengths that no lens has."""
    cameras = [view.camera for view in views]
    spans = [max(camera.width / camera.K[0, 0], camera.height / camera.K[1, 1]) for camera in cameras]
    angles = 2 * np.degrees(np.arctan(np.array(spans) / 2))
    wrong = np.flatnonzero((angles < ANGLES[0]) | (angles > ANGLES[1])).tolist()
    if not wrong:
        return ""
    worst = max(wrong, key=lambda index: abs(math.log(spans[index])))
    camera = cameras[worst]
    px, focal = max(camera.width, camera.height), camera.K[0, 0]
    is_short = angles[worst] > ANGLES[1]
    asked = f"mm? px = mm × {px} / the sensor's mm" if is_short else "px of a larger image?"
    return (
        f"{_named([views[i] for i in wrong])}: the focal length is {focal:.6g} px for {px} px, a field of view of "
        f"{angles[worst]:.3g}°, which lenses do not have; is it in {asked}"
    )


def _about_lenses(views: Sequence[View]) -> str:
    """Doubt cameras of several sizes or focal lengths; a camera on its side is the same one."""
    cameras = [view.camera for view in views]
    numbers = np.array([(*sorted((camera.width, camera.height)), camera.K[0, 0]) for camera in cameras])
    steps = np.round(np.log(numbers / np.median(numbers, axis=0)) / math.log(STEP))
    _, kind, counts = np.unique(steps, axis=0, return_inverse=True, return_counts=True)
    if len(counts) == 1:
        return ""
    spans = numbers[:, 2] / numbers[:, 1]
    few = [view for view, of in zip(views, kind.ravel(), strict=True) if of == counts.argmin()]
    if np.ptp(np.log(spans)) < math.log(STEP) / 2 and len(few) <= RESIZED * len(views):
        camera, most = few[0].camera, views[int(np.flatnonzero(kind.ravel() == counts.argmax())[0])].camera
        return (
            f"{_named(few)}: {camera.width}×{camera.height} px, most others {most.width}×{most.height} px, with the "
            "same field of view: an image resized? Give all images one size, or set data.width"
        )
    words = []
    for number in np.argsort(-counts, kind="stable")[:MOST_KINDS]:
        members = [view for view, of in zip(views, kind.ravel(), strict=True) if of == number]
        camera = members[0].camera
        words.append(f"{_named(members)}: {camera.width}×{camera.height} px, focal length {camera.K[0, 0]:.6g} px")
    more = f" and {len(counts) - MOST_KINDS} more" if len(counts) > MOST_KINDS else ""
    return (
        f"cameras of {len(counts)} kinds ({'; '.join(words)}{more}); make a scene of each or, of one lens, calibrate "
        "all images together"
    )


def _about_blind(views: Sequence[View], points: np.ndarray, sight: Sight) -> str:
    """Doubt views that none of the points (N, 3) lies in, if others have many."""
    share = sight.seen.mean(axis=1)
    blind, typical = np.flatnonzero(share == 0), share[share > 0]
    if not len(blind) or (len(typical) and np.median(typical) * len(points) < FEWEST_SEEN):
        return ""
    most = max(1, MOST_PROJECTED // len(points))
    some = blind[:: -(-len(blind) // most)].tolist()
    found = [views[i] for i in some if not views[i].camera.shows(points).any()]
    if not found:
        return ""
    asked = "correct their poses" if len(typical) else "are points and poses of one world and one convention of axes?"
    return f"{_named(found)}: none of the {len(points)} sparse points lies in the image; {asked}"


def _about_lost(cameras: Sequence[Camera], points: np.ndarray, sight: Sight) -> str:
    """Doubt points (N, 3) that lie behind all cameras, or too far away for a parallax."""
    centers = centers_of(cameras)
    baseline = np.linalg.norm(np.ptp(centers, axis=0))
    away = np.linalg.norm(sample_of(points) - centers.mean(axis=0), axis=1)
    lost = ~(sight.z > 0).any(axis=0) | (baseline < LEAST_PARALLAX * away)
    if lost.mean() <= MAX_LOST or baseline == 0:
        return ""
    return (
        f"about {lost.mean():.0%} of the {len(points)} sparse points lie behind all cameras, or so far away that all "
        "views show them in one direction, and init=random_box fills the space up to them; remove them (colmap "
        "point_filtering), or use init=random"
    )


def _named(views: Collection[View]) -> str:
    """Return the name of the first view, and the number of others."""
    names = sorted(view.name for view in views)
    return f"view {names[0]}" + (f" and {len(names) - 1} more" if len(names) > 1 else "")


def _points(scene: Scene) -> np.ndarray | None:
    return None if scene.points is None else scene.points.points

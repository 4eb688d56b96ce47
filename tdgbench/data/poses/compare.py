"""`tdgbench data poses SCENE REFERENCE`: errors of poses after the similarity that brings positions together."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pycolmap
from scipy.spatial.distance import pdist
from scipy.spatial.transform import Rotation

from tdgbench.data.poses import Reference
from tdgbench.data.poses.references import READ, read_reference
from tdgbench.scenes.errors import SceneError
from tdgbench.terminal import say

FEWEST = 3  # views: three positions determine a similarity
OUTLIER = 3.0  # × the median position error
ROUNDS = 20  # of fitting without outliers, at most
THINNEST = 0.01  # spread of positions across a line, × along it, from which rotations about the line are known


class Comparison(NamedTuple):
    """Errors of N views after a similarity."""

    rotation: np.ndarray | None  # (N,) degrees; None if the positions lie on a line
    position: np.ndarray  # (N,) × extent
    extent: float  # greatest distance of two of the reference's positions, in its units
    fitted: int  # views that determine the similarity; others are outliers
    scale: float  # reference units per unit


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", type=Path, metavar="SCENE", help="the scene's folder, in any layout")
    parser.add_argument("reference", type=Path, metavar="REFERENCE", help=READ)


def run(arguments: argparse.Namespace) -> int:
    """Print how far the scene's poses are from the reference's."""
    scene, reference = read_reference(arguments.scene), read_reference(arguments.reference)
    result = compare(scene.poses, reference.poses)
    total = f"{len(scene.poses)} and {len(reference.poses)}"
    say(f"views: {len(result.position)} in both, of {total}; similarity of {result.fitted}")
    for note in (*scene.notes, *reference.notes):
        say(f"note: {note}")
    if result.rotation is None:
        say("rotation: n/a (the positions lie on a line, about which they determine no rotation)")
    else:
        say(f"rotation: {_spread(result.rotation)} degrees")
    say(f"position: {_spread(100 * result.position)} % of the extent, {result.extent:.6g} in the reference's units")
    say(f"focal length: {_focal(scene)}; reference: {_focal(reference)}")
    return 0


def compare(poses: dict[str, np.ndarray], reference: dict[str, np.ndarray]) -> Comparison:
    """Compare world-to-camera poses (4, 4) of the views that both have, by name.

    Raises SceneError for too few, or positions without extent.
    """
    views = [name for name in poses if name in reference]
    if len(views) < FEWEST:
        names, others = (f"{', '.join(sorted(one)[:2])} …" for one in (poses, reference))
        raise SceneError(
            f"{len(views)} views have one name in both ({names} against {others}); {FEWEST} are needed. Rename the "
            "images of one, without their folders and extensions"
        )
    ours, theirs = (np.stack([one[name] for name in views]) for one in (poses, reference))
    source, target = (-np.einsum("nji,nj->ni", one[:, :3, :3], one[:, :3, 3]) for one in (ours, theirs))
    similarity, errors, fitted = _fit(source, target)
    relative = ours[:, :3, :3] @ similarity.rotation.matrix().T @ theirs[:, :3, :3].transpose(0, 2, 1)
    rotation = np.degrees(Rotation.from_matrix(relative).magnitude())
    along, across, _ = np.linalg.svd(target - target.mean(axis=0), compute_uv=False)
    extent = float(pdist(target).max())
    known = rotation if across > THINNEST * along else None
    return Comparison(known, errors / extent, extent, fitted, float(similarity.scale))


def _fit(source: np.ndarray, target: np.ndarray) -> tuple[pycolmap.Sim3d, np.ndarray, int]:
    """Return the similarity (Umeyama 1991) from positions (N, 3) to others, distances (N,) after it, and inliers.

    It is fitted again without those farther off than OUTLIER medians, until they stay the same.
    """
    kept = np.ones(len(source), bool)
    for _ in range(ROUNDS):
        found = pycolmap.estimate_sim3d(source[kept], target[kept])
        if found is None or not found.scale > 0:
            raise SceneError("the common views have one position: no similarity brings them together")
        similarity: pycolmap.Sim3d = found
        moved = source @ (similarity.scale * similarity.rotation.matrix()).T + similarity.translation
        errors = np.linalg.norm(moved - target, axis=1)
        near = errors <= max(OUTLIER * np.median(errors), 1e-9 * np.ptp(target))
        if np.array_equal(near, kept):
            break
        kept = near
    return similarity, errors, int(kept.sum())


def _spread(errors: np.ndarray) -> str:
    return f"median {np.median(errors):.3g}, 90 % below {np.percentile(errors, 90):.3g}, largest {errors.max():.3g}"


def _focal(reference: Reference) -> str:
    """Return the cameras' focal lengths, also as shares of the width, which resizing leaves as they are."""
    try:
        known = sorted({(one.params[0], one.width) for one in reference.lenses()})
    except SceneError as error:
        return f"n/a ({error})"
    shown = [f"{focal:.1f} px of {width} ({focal / width:.4f} × the width)" for focal, width in known[:2]]
    return (", ".join(shown) + " …" * (len(known) > 2)) or "n/a (not stated)"

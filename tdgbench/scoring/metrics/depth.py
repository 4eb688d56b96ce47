"""Depth against the truth, or against the depth of another view where the truth is unknown."""

from __future__ import annotations

import numpy as np

from tdgbench.scenes import Camera, View
from tdgbench.scoring.metric import ViewMetric
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView

FLOATER = 0.1  # rendered nearer than the true surface by more than this share of its depth
MIN_OVERLAP = 0.05  # share of a view's pixels that must fall into the other view


def depth_abs_rel(depth: np.ndarray, truth: np.ndarray) -> float:
    """Return the mean of |z − z_true| / z_true over equally shaped depths.

    >>> round(depth_abs_rel(np.array([[1.1, 2.0]]), np.array([[1.0, 2.0]])), 6)
    0.05
    """
    return float((np.abs(depth.astype(np.float64) - truth) / truth).mean())


def floater_share(depth: np.ndarray, truth: np.ndarray) -> float:
    """Return the share of the pixels whose rendered depth lies clearly in front of the true surface.

    >>> floater_share(np.array([[0.8, 0.95]]), np.array([[1.0, 1.0]]))
    0.5
    """
    return float((depth < (1 - FLOATER) * truth).mean())


def depth_inconsistency(
    depth: np.ndarray, camera: Camera, other_depth: np.ndarray, other_camera: Camera
) -> float | None:
    """Return the median relative difference of a view's depth (H, W), projected into another view, and the depth there.

    0: both views show one surface. The median ignores what only one of them shows. None where too few pixels of the
    view fall into the other one.
    """
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns].astype(np.float64)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))], axis=1)
    local = pixels @ np.linalg.inv(camera.K).T * z[:, None]
    world = (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
    pixels, projected = other_camera.project(world)
    inside = other_camera.holds(pixels, projected)
    x, y = pixels[inside].astype(int).T
    there = other_depth[y, x]
    known = there > 0
    if known.sum() < MIN_OVERLAP * depth.size:
        return None
    return float(np.median(np.abs(there[known] / projected[inside][known] - 1)))


def _against_nearest(shown: ScoredView) -> float:
    """Return the depth inconsistency with the nearest other test view."""
    nearest = shown.nearest_test_view()
    depth = _known(shown.rendered.known_depth, shown.view)
    other = _known(shown.renders[nearest.name].known_depth, nearest)
    error = depth_inconsistency(depth, shown.view.camera, other, nearest.camera)
    if error is None:
        raise NotApplicableError(f"view {shown.view.name} and its neighbour hardly overlap")
    return error


def _known(depth: np.ndarray, view: View) -> np.ndarray:
    """Return a rendered depth (H, W), 0 at masked pixels as where nothing was rendered."""
    return depth if view.valid is None else np.where(view.valid, depth, np.float32(0))


DEPTH_ABS_REL = ViewMetric(
    name="depth_abs_rel", label="depth error", meaning="mean of |z − true z| / true z", order=90, needs="true depth",
    of_view=lambda shown: depth_abs_rel(*shown.depths()),
)  # fmt: skip
FLOATERS = ViewMetric(
    name="floaters", label="floaters", meaning="share of pixels more than 10 % nearer than the true surface",
    order=100, limits=(0.0, 1.0), needs="true depth", of_view=lambda shown: floater_share(*shown.depths()),
)  # fmt: skip
DEPTH_INCONSISTENCY = ViewMetric(
    name="depth_inconsistency", label="depth inconsistency",
    meaning="median relative difference of the depths of neighbouring test views", order=110,
    needs="two test views that overlap",
    verified_to=1e-3,  # processors round depths differently
    of_view=_against_nearest,
)  # fmt: skip

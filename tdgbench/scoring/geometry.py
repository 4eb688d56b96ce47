"""How good rendered depth is: against the true depth where it is known, else against the depth of another view."""

from __future__ import annotations

import numpy as np

from tdgbench.scenes import Camera

FLOATER = 0.1  # rendered nearer than the true surface by more than this share of its depth
MIN_OVERLAP = 0.05  # share of a view's pixels that must fall into the other view


def depth_abs_rel(depth: np.ndarray, truth: np.ndarray) -> float:
    """Mean of |z − z_true| / z_true over maps (H, W)."""
    return float((np.abs(depth.astype(np.float64) - truth) / truth).mean())


def floater_share(depth: np.ndarray, truth: np.ndarray) -> float:
    """Share of the pixels (H, W) whose rendered depth lies clearly in front of the true surface."""
    return float((depth < (1 - FLOATER) * truth).mean())


def depth_consistency(depth: np.ndarray, camera: Camera, other_depth: np.ndarray, other_camera: Camera) -> float | None:
    """Median relative difference of a view's depth (H, W), carried over into another view, and that view's depth.

    0: both views see one surface. The median leaves out what one of them does not see. None where too few pixels of
    the view fall into the other one.
    """
    rows, columns = np.nonzero(depth > 0)
    z = depth[rows, columns].astype(np.float64)
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(z))], axis=1)
    local = pixels @ np.linalg.inv(camera.K).T * z[:, None]
    world = (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]
    there, carried = other_camera.project(world)
    x, y = (np.floor(np.nan_to_num(there[:, i], nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(int) for i in (0, 1))
    inside = (carried > 0) & (x >= 0) & (x < other_camera.width) & (y >= 0) & (y < other_camera.height)
    found = other_depth[y[inside], x[inside]]
    known = found > 0
    if known.sum() < MIN_OVERLAP * depth.size:
        return None
    return float(np.median(np.abs(found[known] / carried[inside][known] - 1)))

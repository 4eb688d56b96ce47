"""Initial Gaussians: one isotropic Gaussian per point, scaled to its neighbours (3DGS, `create_from_pcd`)."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import KDTree

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.harmonics import num_bases, sh_from_color

INITIAL_OPACITY = 0.1
MIN_SQUARED_DISTANCE = 1e-7  # 3DGS, for duplicate points


def neighbour_distances(points: np.ndarray) -> np.ndarray:
    """Return the root mean square distance (N,) of points (N, 3) to their 3 nearest neighbours (3DGS, `distCUDA2`).

    With fewer than 4 points it uses the existing neighbours; a single point gets the floor.

    >>> neighbour_distances(np.array([[0.0, 0, 0], [2.0, 0, 0]])).tolist()
    [2.0, 2.0]
    """
    neighbours = min(3, len(points) - 1)
    if neighbours < 1:
        return np.full(len(points), MIN_SQUARED_DISTANCE**0.5)
    distances, _ = KDTree(points).query(points, k=neighbours + 1)
    return np.sqrt(np.maximum((distances[:, 1:] ** 2).mean(axis=1), MIN_SQUARED_DISTANCE))


def gaussians_from_points(points: np.ndarray, colors: np.ndarray, channels: int, sh_degree: int) -> Gaussians:
    """Return Gaussians (float32) at points (N, 3), world units; colours (N, 3) in [0, 1], of which gray ones are means.

    colors: (N, channels) for more than three channels. Raises ValueError without points, or if they are not finite.

    >>> gaussians = gaussians_from_points(np.eye(3), np.full((3, 3), 0.5), channels=1, sh_degree=2)
    >>> tuple(gaussians.sh.shape), round(gaussians.opacities[0].item(), 3), round(gaussians.scales[0, 0].item(), 3)
    ((3, 9, 1), 0.1, 1.414)
    """
    if len(points) == 0:
        raise ValueError("the point cloud is empty; use init=random, or give a COLMAP model with points")
    if not np.isfinite(points).all():
        raise ValueError(f"{int((~np.isfinite(points)).any(axis=1).sum())} points of the cloud are not finite")
    count = len(points)
    color = torch.from_numpy(np.ascontiguousarray(colors, np.float32))
    if channels == 1:
        color = color.mean(dim=1, keepdim=True)
    sh = torch.zeros(count, num_bases(sh_degree), channels)
    sh[:, 0] = sh_from_color(color)
    distances = torch.from_numpy(neighbour_distances(points).astype(np.float32))
    quats = torch.zeros(count, 4)
    quats[:, 0] = 1.0
    return Gaussians(
        means=torch.from_numpy(np.ascontiguousarray(points, np.float32)),
        log_scales=distances.log()[:, None].repeat(1, 3),
        quats=quats,
        opacity_logits=torch.full((count,), INITIAL_OPACITY).logit(),
        sh=sh,
    )

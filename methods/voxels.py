"""Gaussians of the points in voxels, from which SAD-GS starts (scene/initialize_utils.py, scene/gaussian_model.py)."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from tdgbench.splats import Gaussians
from tdgbench.splats.harmonics import num_bases, sh_from_color

OPAQUE = 40.0  # logit: the opacity is 1 and has no gradient, as with the authors' infinite logit
SCALE = 2.0  # × standard deviation of a voxel's points: gaussian_model.py, line 226
FLATTEST = 1e-4  # × voxel: least standard deviation; that of coplanar points is 0, whose logarithm is infinite


def voxels(points: np.ndarray, colors: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return means (V, 3), colours (V, C) and covariances (V, 3, 3) of points (P, 3) in the V voxels that have some.

    A single point gets the mean variance of the others, in all directions. size: side of a voxel, world units.
    """
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)[:, ::-1]
    number = np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1))
    _, voxel, counts = np.unique(number, return_inverse=True, return_counts=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(voxel, column) for column in values.T], axis=1) / counts[:, None]

    means, several, covariances = mean(points), counts > 1, np.empty((len(counts), 3, 3))
    offsets = points - means[voxel]
    for i, j in np.ndindex(3, 3):  # one after the other: there may be many points
        covariances[:, i, j] = np.bincount(voxel, offsets[:, i] * offsets[:, j]) / np.maximum(counts - 1, 1)
    typical = np.trace(covariances[several], axis1=1, axis2=2).mean() / 3 if several.any() else size**2 / 12
    covariances[~several] = typical * np.eye(3)
    return means, mean(colors), covariances


def voxel_gaussians(points: np.ndarray, colors: np.ndarray, size: float, sh_degree: int) -> Gaussians:
    """Return one opaque Gaussian (float32) per voxel, with twice the deviations of its points; see `voxels`."""
    means, color, covariances = voxels(points, colors, size)
    variances, axes = np.linalg.eigh(covariances)
    axes[..., 2] *= np.linalg.det(axes)[:, None]
    sh = torch.zeros(len(means), num_bases(sh_degree), color.shape[1])
    sh[:, 0] = sh_from_color(torch.from_numpy(color).float())
    return Gaussians(
        means=torch.from_numpy(means).float(),
        log_scales=torch.from_numpy(np.log(SCALE * np.sqrt(variances.clip((FLATTEST * size) ** 2)))).float(),
        quats=torch.from_numpy(Rotation.from_matrix(axes).as_quat(scalar_first=True)).float(),
        opacity_logits=torch.full((len(means),), OPAQUE),
        sh=sh,
    )

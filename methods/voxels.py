"""Gaussians of the points in voxels, as SAD-GS starts from them (scene/initialize_utils.py, gaussian_model.py)."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from tdgbench.splats import Gaussians
from tdgbench.splats.harmonics import num_bases, sh_from_color

OPAQUE = 40.0  # logit: the opacity is 1 and has no gradient, as the infinite one of the authors
SCALE = 2.0  # × standard deviation of a voxel's points: gaussian_model.py, line 226
FLATTEST = (
    1e-4  # × side of a voxel: least standard deviation; that of coplanar points is 0, whose logarithm is infinite
)


def voxels(points: np.ndarray, colors: np.ndarray, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return means (V, 3), colours (V, C) and covariances (V, 3, 3) of points (P, 3) in the V voxels that have some.

    A single point gets the mean variance of the others, in all directions.
    """
    cells = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    counts_along = cells.max(axis=0) + 1
    numbers = (cells[:, 2] * counts_along[1] + cells[:, 1]) * counts_along[0] + cells[:, 0]
    _, voxel, counts = np.unique(numbers, return_inverse=True, return_counts=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return (
            np.stack([np.bincount(voxel, part, len(counts)) for part in values.T.astype(np.float64)], 1)
            / counts[:, None]
        )

    means = mean(points)
    centered, several = points - means[voxel], counts > 1
    covariances = np.empty((len(counts), 3, 3))
    for i, j in np.ndindex(3, 3):  # one after the other: there are many points
        covariances[:, i, j] = np.bincount(voxel, centered[:, i] * centered[:, j]) / np.maximum(counts - 1, 1)
    typical = np.trace(covariances[several], axis1=1, axis2=2).mean() / 3 if several.any() else size**2 / 12
    covariances[~several] = typical * np.eye(3)
    return means, mean(colors), covariances


def voxel_gaussians(points: np.ndarray, colors: np.ndarray, size: float, sh_degree: int) -> Gaussians:
    """Return one opaque Gaussian (float32) per voxel of a size, with twice the standard deviations of its points."""
    means, color, covariances = voxels(points, colors, size)
    variances, axes = np.linalg.eigh(covariances)
    axes[..., 2] *= np.sign(np.linalg.det(axes))[:, None]
    scales = SCALE * np.sqrt(np.maximum(variances, (FLATTEST * size) ** 2))
    quats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    sh = torch.zeros(len(means), num_bases(sh_degree), color.shape[1])
    sh[:, 0] = sh_from_color(torch.from_numpy(color.astype(np.float32)))
    at, log_scales, turned = (torch.from_numpy(array.astype(np.float32)) for array in (means, np.log(scales), quats))
    return Gaussians(at, log_scales, turned, torch.full((len(at),), OPAQUE), sh)

"""How alike renders and images are in their detail: neither brightness nor contrast nor slow shading counts."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.ndimage import gaussian_filter

from tdgbench.scenes.images import resize

WIDTH = 160  # px, of what is compared
FINE, COARSE = 1.5, 8.0  # px, σ of the Gaussians between which lies the detail
LEAST = 0.1  # correlation of a render with its own image
LEAD, RESIDUAL = 0.02, 0.85  # of an image that fits better: its lead, and its share of what its own leaves unexplained


def details(images: Iterable[np.ndarray], valid: Iterable[np.ndarray | None]) -> np.ndarray:
    """Return the detail of images (H, W, C) as rows (N, P) of mean 0 and norm 1, whose products are correlations.

    valid: (H, W) bool, pixels that count; None: all. All are shrunk to the shape of the first image.
    """
    rows: list[np.ndarray] = []
    height = 0
    for image, mask in zip(images, valid, strict=True):
        height = height or max(1, round(WIDTH * image.shape[0] / image.shape[1]))
        gray = resize(image.astype(np.float32), WIDTH, height).mean(axis=2, dtype=np.float64)
        if mask is not None:
            hidden = resize(mask[..., None].astype(np.float32), WIDTH, height)[..., 0] < 1 - 1e-6
            gray[hidden] = 0 if hidden.all() else gray[~hidden].mean()
        row = (gaussian_filter(gray, FINE) - gaussian_filter(gray, COARSE)).ravel()
        row -= row.mean()
        rows.append((row / max(float(np.linalg.norm(row)), 1e-9)).astype(np.float32))
    return np.stack(rows)


def fits_better(other: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Return whether a render shows another view than its own, by its correlations with both images.

    Of 1 160 renders by 29 models (12 to 39 dB; 40 views of each of eight built-in scenes and of a capture of an arch)
    none fits another view's image better. After any two are exchanged, 22 617 of 22 620 times one of them does.

    >>> fits_better(np.array([0.9, 0.5, 0.99]), np.array([0.2, 0.45, 0.93])).tolist()
    [True, False, True]
    """
    return (other > own + LEAD) & (1 - other < RESIDUAL * (1 - own))

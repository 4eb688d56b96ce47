"""Pictures of thermal images in which COLMAP finds features: a few degrees of contrast, spread over all gray levels."""

from __future__ import annotations

import numpy as np
from skimage.exposure import equalize_adapthist

TAILS = 0.5, 99.5  # percentiles of an image that become black and white
CLIP_LIMIT = 0.02  # of CLAHE, as a share of a tile's pixels


def picture(thermal: np.ndarray) -> np.ndarray:
    """Return gray levels (H, W) uint8 of a thermal image (H, W) or (H, W, C): its own range, then CLAHE.

    Invalid pixels (NaN) become black.
    """
    gray = thermal if thermal.ndim == 2 else thermal.mean(axis=2)
    low, high = np.nanpercentile(gray, TAILS)
    stretched = np.nan_to_num(np.clip((gray - low) / max(high - low, 1e-12), 0, 1))
    return np.round(255 * equalize_adapthist(stretched, clip_limit=CLIP_LIMIT)).astype(np.uint8)

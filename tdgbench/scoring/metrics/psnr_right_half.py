"""PSNR of a view's right half after the gain and offset that fit its left half best."""

from __future__ import annotations

import numpy as np

from tdgbench.scoring.metric import ImageMetric
from tdgbench.scoring.metrics.psnr import IN_DB, psnr
from tdgbench.scoring.metrics.psnr_affine import best_gain_and_offset
from tdgbench.scoring.scored_view import NotApplicableError, at_valid


def psnr_right_half(image: np.ndarray, target: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Return the PSNR (dB) of the right half of images (H, W, C) in [0, 1], whose columns from W // 2 on it is.

    The two parameters of a test view are not known before; they are fitted where the view is not scored, as NeRF in the
    Wild (Martin-Brualla et al. 2021) fits its embeddings. valid: bool (H, W), the pixels that count; None: all. Raises
    NotApplicableError if a half has none.

    >>> target = np.tile(np.linspace(0.2, 0.6, 8), (4, 1))[..., None]
    >>> round(psnr_right_half(0.5 * target + 0.2, target))
    100
    """
    half = image.shape[1] // 2
    left, right = (
        [at_valid(None if valid is None else valid[:, columns], pixels[:, columns]) for pixels in (image, target)]
        for columns in (slice(0, half), slice(half, None))
    )
    if not (left[0].size and right[0].size):
        raise NotApplicableError("a half of a test view has no pixel with a thermal value")
    return psnr(best_gain_and_offset(*left).of(right[0]), right[1])


METRIC = ImageMetric(
    name="psnr_right_half",
    label="right half",
    meaning="PSNR of each test view's right half, after the gain and offset that fit its left half best",
    order=44,
    **IN_DB,
    fits_to_test_view="gain and offset, to the left half",
    needs="valid pixels in both halves",
    of_images=lambda pair: psnr_right_half(pair.image, pair.target, pair.valid),
)

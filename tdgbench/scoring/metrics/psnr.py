"""Peak signal-to-noise ratio: of 8-bit pictures, by channel of float renders, and after a fitted gain and offset.

The last removes the effect of a drifting camera.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from tdgbench.scoring.metric import ImageMetric, ViewMetric
from tdgbench.scoring.scored_view import NotApplicableError, ScoredView, at_valid

MAX_PSNR = 100.0  # dB; of equal images, so that means stay finite
IN_DB: dict[str, Any] = {"unit": "dB", "digits": 2, "higher_is_better": True, "limits": (0.0, MAX_PSNR)}


def psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Return −10 log10 of the mean squared error over all pixels and channels (dB), images (…, C) in [0, 1].

    >>> round(psnr(np.full((4, 4, 1), 0.6), np.full((4, 4, 1), 0.5)), 6)
    20.0
    """
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {image.shape} and {target.shape}")
    return psnr_of(float(np.mean((image.astype(np.float64) - target.astype(np.float64)) ** 2)))


def psnr_of(mse: float) -> float:
    """Return the PSNR (dB) of a mean squared error of values in [0, 1].

    >>> psnr_of(0.01), psnr_of(0.0)
    (20.0, 100.0)
    """
    return MAX_PSNR if mse <= 10 ** (-MAX_PSNR / 10) else -10 * float(np.log10(mse))


def channel_psnr(image: np.ndarray, target: np.ndarray) -> float:
    """Return the mean over channels of each channel's PSNR (dB) of images (…, C), clipped to [0, 1].

    ThermalGaussian's and 3DGS's `training_report` gives this for float renders; their `metrics.py` pools channels. The
    two agree for gray images and are some tenths to 1 dB apart for pseudo-colour.

    >>> target = np.full((4, 4, 2), 0.5)
    >>> round(channel_psnr(target + [0.1, 0.01], target), 6)  # mean of 20 and 40 dB
    30.0
    """
    image, target = np.clip(image, 0, 1), np.clip(target, 0, 1)
    return float(np.mean([psnr(image[..., c], target[..., c]) for c in range(image.shape[-1])]))


def _of_view(shown: ScoredView) -> float:
    return channel_psnr(*(at_valid(shown.valid, image) for image in (shown.rendered.image, shown.view.thermal)))


class GainAndOffset(NamedTuple):
    """A view's two parameters: value = gain · rendered value + offset, the same for all channels."""

    gain: float
    offset: float

    def applied_to(self, image: np.ndarray) -> np.ndarray:
        """Return the image with this gain and offset, clipped to [0, 1]."""
        return np.clip(self.gain * image.astype(np.float64) + self.offset, 0, 1)


def best_gain_and_offset(image: np.ndarray, target: np.ndarray) -> GainAndOffset:
    """Return the gain ≥ 0 and offset that bring an image nearest to its target, by least squares over all values.

    A gain below 0 would turn hot into cold. An image of one value gets an offset only.

    >>> image = np.array([0.2, 0.4, 0.6])
    >>> response = best_gain_and_offset(image, 0.5 * image + 0.1)
    >>> round(response.gain, 6), round(response.offset, 6)
    (0.5, 0.1)
    """
    x, y = image.astype(np.float64), target.astype(np.float64)
    spread = float(np.mean((x - x.mean()) ** 2))
    gain = max(float(np.mean((x - x.mean()) * (y - y.mean()))) / spread, 0.0) if spread > 0 else 1.0
    return GainAndOffset(gain, float(y.mean() - gain * x.mean()))


def psnr_affine(image: np.ndarray, target: np.ndarray) -> float:
    """Return the PSNR (dB) of images (…, C) in [0, 1] after the render's best gain and offset.

    nerfbaselines and gsplat call PSNR after a fitted affine map of colours colour-corrected; theirs has a 3×3 matrix,
    which has no meaning for temperatures.
    """
    return psnr(best_gain_and_offset(image, target).applied_to(image), target)


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
    return psnr(best_gain_and_offset(*left).applied_to(right[0]), right[1])


PSNR = ImageMetric(
    name="psnr", label="PSNR", meaning="peak signal-to-noise ratio, over all channels", order=10, **IN_DB,
    in_main_table=True, of_every_modality=True, on_training_views=True, of_images=lambda pair: psnr(*pair.pixels),
)  # fmt: skip
CHANNEL_PSNR = ViewMetric(
    name="channel_psnr", label="PSNR by channel",
    meaning="mean of the channels' PSNR, of renders that are not rounded to 8 bits", order=40, **IN_DB,
    of_view=_of_view,
)  # fmt: skip
PSNR_AFFINE = ImageMetric(
    name="psnr_affine", label="PSNR after gain and offset",
    meaning="PSNR after the gain and offset of each test view that fit it best", order=42, **IN_DB,
    fits_to_test_view="gain and offset", of_images=lambda pair: psnr_affine(*pair.pixels),
)  # fmt: skip
PSNR_RIGHT_HALF = ImageMetric(
    name="psnr_right_half", label="right half", beside="psnr",
    meaning="PSNR of each test view's right half, after the gain and offset that fit its left half best", order=44,
    **IN_DB, fits_to_test_view="gain and offset, to the left half", needs="valid pixels in both halves",
    of_images=lambda pair: psnr_right_half(pair.image, pair.target, pair.valid),
)  # fmt: skip

"""The rule for pixels: low resolutions first, each for the share of the schedule that its frequencies have.

This is the schedule of DashGaussian (Chen et al. 2025), except that noise does not count as spectrum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, PositiveInt

from tdgbench.scenes import View
from tdgbench.scenes.images import nearest_valid
from tdgbench.training.curriculum import Resolution
from tdgbench.training.images import Modality, noise_of
from tdgbench.training.rule import Rule
from tdgbench.training.skips import NO_GAUSSIANS, Finished, Skip

SCALES = (8, 6, 4, 3, 2, 1)
CERTAIN = 5.0  # times the mean power of noise, which e⁻⁵ of its frequencies exceed


@dataclass(frozen=True)
class PixelRule(Rule):
    """Train at low resolutions first. Held-out views may end a resolution before its schedule does (`SettlingRule`)."""

    largest_scale: Annotated[int, Field(ge=1, le=SCALES[0])]
    until: Annotated[float, Field(gt=0, le=1)]  # share of all iterations, after which images have all their pixels
    smallest_side: PositiveInt  # px, of an image at any scale

    def resolutions(self, views: list[View], images: Modality, gaussians: int, iterations: int) -> list[Resolution]:
        """Return the resolutions that save time: images with fewer pixels than Gaussians save little."""
        if not views:
            return []
        side = min(min(view.camera.width, view.camera.height) for view in views)
        pixels = min(view.camera.width * view.camera.height for view in views)
        low = [scale for scale in SCALES if 1 < scale <= self.largest_scale and side // scale >= self.smallest_side]
        scales = (*(scale for scale in low if pixels >= gaussians * scale**2), 1)
        amplitudes = []  # without masked pixels
        for view in views:
            image, valid = images.array(view), images.valid(view)
            amplitudes.append(significant_amplitudes(nearest_valid(image, valid), noise_of(image, valid), scales))
        shares = np.mean(amplitudes, axis=0)
        ends = [int(share * self.until * iterations) for share in shares]
        return [Resolution(end, scale) for end, scale in zip(ends, scales, strict=True) if scale > 1 and end > 0]

    def account(self, skip: Skip, training: Finished) -> None:
        trained: dict[int, int] = {}
        for curriculum, _ in training.curricula:
            for scale, count in curriculum.iterations.items():
                trained[scale] = trained.get(scale, 0) + count
        reason = ", ".join(
            f"{count} iterations at 1/{scale}" for scale, count in trained.items() if scale > 1 and count
        )
        left_out = sum(count * (1 - 1 / scale**2) for scale, count in trained.items())
        nothing = (
            "the images are too small for so many Gaussians, or all of their spectrum is in their highest frequencies"
        )
        if training.keeps_full_resolution:
            nothing = "the steps of this method need whole images"
        reason = reason or (nothing if training.work else NO_GAUSSIANS)
        skip.decide(left_out > 0, reason, f"{left_out / max(sum(trained.values()), 1):.0%} of the pixels")


def significant_amplitudes(image: np.ndarray, noise: float, scales: tuple[int, ...]) -> np.ndarray:
    """Return the share (scales,) of an image's amplitudes that its versions 1/scale as large still have; 1 for scale 1.

    The sum of amplitudes below a version's highest frequency, over that of all, is DashGaussian's measure (Chen et al.
    2025). Here only frequencies that stand out of white noise count, and the mean of the image does not.

    image: (H, W, C). noise: standard deviation, in its units. An image that is nothing but noise has 1 at every scale.

    >>> x = np.linspace(0, 8 * np.pi, 64, endpoint=False)
    >>> wave = np.broadcast_to(np.cos(x)[:, None, None], (64, 64, 1))  # 4 periods, 16 px each
    >>> significant_amplitudes(wave, 1e-3, (16, 8, 4, 1)).round(2).tolist()
    [0.0, 0.74, 1.0, 1.0]
    """
    height, width = image.shape[:2]
    window = np.outer(np.hanning(height), np.hanning(width))
    rows, columns = np.fft.fftfreq(height), np.fft.fftfreq(width)
    frequency = np.maximum(np.abs(rows)[:, None], np.abs(columns))  # cycles per px
    amplitudes = np.zeros((height, width))
    for channel in np.moveaxis(image.astype(np.float64), -1, 0):
        power = np.abs(np.fft.fft2((channel - channel.mean()) * window)) ** 2
        amplitudes += np.sqrt(np.where(power > CERTAIN * noise**2 * (window**2).sum(), power, 0.0))
    amplitudes[0, 0] = 0.0
    total = amplitudes.sum()
    if total == 0:
        return np.ones(len(scales))
    return np.array([amplitudes[frequency <= 0.5 / scale].sum() / total if scale > 1 else 1.0 for scale in scales])

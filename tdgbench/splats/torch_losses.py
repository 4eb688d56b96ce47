"""Losses of images and depth maps in plain torch: for tensors without fused kernels, and to check the kernels against.

Images are (H, W, C) in [0, 1]. `valid`: bool (H, W), false for masked pixels; None: every pixel counts.
"""

from __future__ import annotations

import weakref
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

WINDOW, SIGMA = 11, 1.5  # px: side and standard deviation of the Gaussian window of SSIM (Wang et al. 2004)
C1, C2 = 0.01**2, 0.03**2  # of SSIM, for images in [0, 1]
MIN_RANGE = 1e-8  # of a map that min-max normalisation stretches


class LossWeights(NamedTuple):
    """Weights of the terms of an image loss: L1, 1 − SSIM, and smoothness in one of its readings."""

    l1: float
    dssim: float
    smooth: float = 0.0
    reading: str = "written"


def l1_and_dssim(image: Tensor, target: Tensor, weights: LossWeights, valid: Tensor | None) -> Tensor:
    """Return the terms L1 and 1 − SSIM, means over the valid pixels."""
    target = target.detach()
    if valid is None:
        return weights.l1 * (image - target).abs().mean() + weights.dssim * (1 - ssim_map(image, target).mean())
    image, target = without_masked(image, valid), without_masked(target, valid)
    count = valid.sum() * image.shape[2]
    similarity = without_masked(ssim_map(image, target), valid).sum() / count
    return weights.l1 * (image - target).abs().sum() / count + weights.dssim * (1 - similarity)


def window() -> np.ndarray:
    """Return weights float64 (11,) of the separable window.

    >>> window().round(3)[:6]
    array([0.001, 0.008, 0.036, 0.109, 0.213, 0.266])
    """
    offsets = np.arange(WINDOW) - WINDOW // 2
    weights = np.exp(-(offsets**2) / (2 * SIGMA**2))
    return weights / weights.sum()


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """Return the SSIM per pixel and channel (H, W, C) of images (H, W, C)."""
    a, b = (t.permute(2, 0, 1) for t in (image, target))
    mu_a, mu_b, mean_aa, mean_bb, mean_ab = Blur.apply(torch.stack([a, b, a * a, b * b, a * b]))
    covariance = mean_ab - mu_a * mu_b
    variances = (mean_aa - mu_a * mu_a) + (mean_bb - mu_b * mu_b)
    numerator = (2 * mu_a * mu_b + C1) * (2 * covariance + C2)
    denominator = (mu_a * mu_a + mu_b * mu_b + C1) * (variances + C2)
    return (numerator / denominator).permute(1, 2, 0)


def smoothness(image: Tensor, reading: str, valid: Tensor | None) -> Tensor:
    """Return the mean difference of neighbours in one of the readings of `tdgbench.training.losses.smoothness`."""
    count = valid_values(image, valid)
    if valid is not None:
        image = without_masked(image, valid)
    differences = [(here - other).abs() for here, other in _neighbours(image, reading)]
    if valid is not None:
        weights = _neighbours(valid[..., None].to(image.dtype), reading)
        differences = [d * here * other for d, (here, other) in zip(differences, weights, strict=True)]
    total = torch.stack([difference.sum() for difference in differences]).sum()
    return total / count if reading == "released" else 2 * total / (4 * count)


def _neighbours(image: Tensor, reading: str) -> list[tuple[Tensor, Tensor]]:
    """Return pairs of images of neighbouring pixels: down and right, or on a torus all four, which are constants."""
    if reading == "released":
        return [(image, image.detach().roll(shift, dim)) for dim in (0, 1) for shift in (1, -1)]
    return [(image[1:], image[:-1]), (image[:, 1:], image[:, :-1])]


def min_max(values: Tensor) -> Tensor:
    """Normalise a map (H, W) to [0, 1] by its extremes; one without range becomes zero."""
    low, high = values.min(), values.max()
    is_flat = high - low < MIN_RANGE
    return torch.where(is_flat, 0.0, values - low) / torch.where(is_flat, 1.0, high - low)


def inverse_expected_depth(depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
    """Return alpha / accumulated z, maps (H, W); 0 where alpha ≤ min_alpha."""
    alpha = 1.0 - transmittance
    solid = alpha > min_alpha
    return torch.where(solid, alpha / torch.where(solid, depth, 1.0), 0.0)


class ValidPixels:
    """Numbers of valid pixels of masks, by their tensors: the host waits for a GPU once per mask, not in each step."""

    def __init__(self) -> None:
        self._counted: dict[int, tuple[int, int]] = {}  # torch's count of writes to the mask, and its number of pixels

    def of(self, valid: Tensor) -> int:
        """Return the number of valid pixels of a mask (H, W)."""
        stored = self._counted.get(id(valid))
        if stored is None:
            weakref.finalize(valid, self._counted.pop, id(valid), None)
        if stored is None or stored[0] != valid._version:
            stored = self._counted[id(valid)] = (valid._version, int(valid.sum()))
        return stored[1]


_VALID_PIXELS = ValidPixels()


def valid_values(image: Tensor, valid: Tensor | None) -> int:
    """Return the number of values of an image (H, W, C) that count. Raises ValueError if there are none."""
    if valid is None:
        return image.numel()
    count = _VALID_PIXELS.of(valid) * image.shape[2]
    if not count:
        raise ValueError("no pixel of the image is valid, so that it has no loss")
    return count


def without_masked(image: Tensor, valid: Tensor) -> Tensor:
    """Return the image with 0 at masked pixels, whatever it holds there.

    >>> without_masked(torch.tensor([[[torch.nan], [1.0]]]), torch.tensor([[False, True]])).flatten().tolist()
    [0.0, 1.0]
    """
    return torch.where(valid[..., None], image, 0.0)


class Blur(torch.autograd.Function):
    """Images (N, C, H, W) filtered by the Gaussian window, with zeros outside; symmetric, so its own gradient.

    Sums of shifted images instead of a convolution: cuDNN rounds the latter to TF32, whose 10 bits ruin the variances
    of SSIM (`torch.backends.cudnn.allow_tf32` is true by default).
    """

    @staticmethod
    def forward(ctx, images: Tensor) -> Tensor:
        return _filtered(images)

    @staticmethod
    def backward(ctx, grad: Tensor) -> Tensor:
        return _filtered(grad)


def _filtered(images: Tensor) -> Tensor:
    half, weights = WINDOW // 2, window().tolist()
    for dim, padding in ((3, (half, half, 0, 0)), (2, (0, 0, half, half))):
        padded = torch.nn.functional.pad(images, padding)
        first, *others = (padded.narrow(dim, shift, images.shape[dim]) for shift in range(WINDOW))
        images = weights[0] * first
        for weight, shifted in zip(weights[1:], others, strict=True):
            images.add_(shifted, alpha=weight)
    return images

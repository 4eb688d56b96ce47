"""Image losses in plain torch: for types and devices that have no fused kernel, and to check the kernels against.

Images are (H, W, C) in [0, 1]. `valid`: bool (H, W), false for masked pixels; None: every pixel counts.
"""

from __future__ import annotations

import torch
from torch import Tensor

from tdgbench.splats.cpu.losses.ssim import C1, C2, WINDOW, window


def l1_and_dssim(image: Tensor, target: Tensor, l1_weight: float, dssim_weight: float, valid: Tensor | None) -> Tensor:
    """Return l1_weight · L1 + dssim_weight · (1 − SSIM), means over the valid pixels."""
    target = target.detach()
    if valid is None:
        return l1_weight * (image - target).abs().mean() + dssim_weight * (1 - ssim_map(image, target).mean())
    image, target = without_masked(image, valid), without_masked(target, valid)
    count = valid.sum() * image.shape[2]
    similarity = without_masked(ssim_map(image, target), valid).sum() / count
    return l1_weight * (image - target).abs().sum() / count + dssim_weight * (1 - similarity)


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """Return the SSIM per pixel and channel (H, W, C) of images (H, W, C)."""
    a, b = (t.permute(2, 0, 1).unsqueeze(1) for t in (image, target))
    mu_a, mu_b = _blur(a), _blur(b)
    var_a = _blur(a * a) - mu_a * mu_a
    var_b = _blur(b * b) - mu_b * mu_b
    covariance = _blur(a * b) - mu_a * mu_b
    numerator = (2 * mu_a * mu_b + C1) * (2 * covariance + C2)
    denominator = (mu_a * mu_a + mu_b * mu_b + C1) * (var_a + var_b + C2)
    return (numerator / denominator).squeeze(1).permute(1, 2, 0)


def smoothness(image: Tensor, reading: str, valid: Tensor | None, count: int) -> Tensor:
    """The two readings of `tdgbench.training.losses.smoothness`. count: number of values that count."""
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


def without_masked(image: Tensor, valid: Tensor) -> Tensor:
    """Return the image with 0 at masked pixels, whatever it holds there.

    >>> without_masked(torch.tensor([[[torch.nan], [1.0]]]), torch.tensor([[False, True]])).flatten().tolist()
    [0.0, 1.0]
    """
    return torch.where(valid[..., None], image, 0.0)


class _Blur(torch.autograd.Function):
    """Images (C, 1, H, W) filtered by the Gaussian window, with zeros outside; symmetric, so its own gradient.

    Sums of shifted images instead of a convolution: cuDNN rounds the latter to TF32, whose 10 bits ruin the variances
    of SSIM (`torch.backends.cudnn.allow_tf32` is true by default).
    """

    @staticmethod
    def forward(ctx, images: Tensor) -> Tensor:
        return _filtered(images)

    @staticmethod
    def backward(ctx, grad: Tensor) -> Tensor:
        return _filtered(grad)


_blur = _Blur.apply


def _filtered(images: Tensor) -> Tensor:
    half, weights = WINDOW // 2, window().tolist()
    for dim, padding in ((3, (half, half, 0, 0)), (2, (0, 0, half, half))):
        padded = torch.nn.functional.pad(images, padding)
        first, *others = (padded.narrow(dim, shift, images.shape[dim]) for shift in range(WINDOW))
        images = weights[0] * first
        for weight, shifted in zip(weights[1:], others, strict=True):
            images.add_(shifted, alpha=weight)
    return images

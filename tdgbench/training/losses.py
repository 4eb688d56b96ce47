"""Loss terms that methods share: SSIM, the 3DGS photometric loss, and both readings of thermal smoothness.

Images are (H, W, C) in [0, 1].
"""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu.ssim import ssim_and_gradient

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2


def l1(image: Tensor, target: Tensor) -> Tensor:
    """Mean absolute error."""
    return (image - target).abs().mean()


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Mean SSIM with zero padding over images (H, W, C), as 3DGS trains with; the gradient reaches `image` only.

    Float32 on the CPU goes through the fused kernel; other types and devices through torch.
    """
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {tuple(image.shape)} and {tuple(target.shape)}")
    if image.device.type == "cpu" and image.dtype == torch.float32:
        return _FusedSSIM.apply(image, target.detach())
    return ssim_map(image, target.detach()).mean()


def ssim_map(image: Tensor, target: Tensor) -> Tensor:
    """SSIM per pixel and channel (H, W, C), in plain torch."""
    a, b = (t.permute(2, 0, 1).unsqueeze(1) for t in (image, target))
    mu_a, mu_b = _blur(a), _blur(b)
    var_a = _blur(a * a) - mu_a * mu_a
    var_b = _blur(b * b) - mu_b * mu_b
    covariance = _blur(a * b) - mu_a * mu_b
    numerator = (2 * mu_a * mu_b + C1) * (2 * covariance + C2)
    denominator = (mu_a * mu_a + mu_b * mu_b + C1) * (var_a + var_b + C2)
    return (numerator / denominator).squeeze(1).permute(1, 2, 0)


def photometric(image: Tensor, target: Tensor, lambda_ssim: float) -> Tensor:
    """(1 − λ) L1 + λ (1 − SSIM): 3DGS, eq. 7."""
    return (1 - lambda_ssim) * l1(image, target) + lambda_ssim * (1 - ssim(image, target))


def smoothness(image: Tensor, reading: str) -> Tensor:
    """How much neighbouring pixels differ, in one of the two readings that differ in their numbers.

    `paper` (TDg, eq. 6): sum over the 4 neighbours inside the image, divided by 4 M (M: pixels and channels).
    `reference` (ThermalGaussian's code): not divided by 4, neighbours wrap around at the border and are constants.
    """
    if reading == "paper":
        down = (image[1:] - image[:-1]).abs().sum()
        right = (image[:, 1:] - image[:, :-1]).abs().sum()
        return 2 * (down + right) / (4 * image.numel())
    if reading == "reference":
        still = image.detach()
        neighbours = [still.roll(shift, dim) for dim in (0, 1) for shift in (1, -1)]
        total = torch.stack([(image - neighbour).abs().sum() for neighbour in neighbours]).sum()
        return total / image.numel()
    raise ValueError(f"smoothness reading is {reading!r}; it must be 'paper' or 'reference'")


@functools.cache
def _window(dtype: torch.dtype, device: torch.device) -> Tensor:
    offsets = torch.arange(WINDOW, dtype=dtype, device=device) - WINDOW // 2
    weights = torch.exp(-(offsets**2) / (2 * SIGMA**2))
    return weights / weights.sum()


def _blur(images: Tensor) -> Tensor:
    """The separable Gaussian window over (C, 1, H, W), zeros outside."""
    w = _window(images.dtype, images.device)
    half = WINDOW // 2
    images = torch.nn.functional.conv2d(images, w.view(1, 1, 1, -1), padding=(0, half))
    return torch.nn.functional.conv2d(images, w.view(1, 1, -1, 1), padding=(half, 0))


class _FusedSSIM(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image, target):
        a, b = (np.ascontiguousarray(t.detach().numpy()) for t in (image, target))
        value, gradient = ssim_and_gradient(a, b)
        ctx.gradient = torch.from_numpy(gradient)
        return torch.tensor(value, dtype=torch.float32)

    @staticmethod
    def backward(ctx, grad):
        return grad * ctx.gradient, None

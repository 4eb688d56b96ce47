"""Loss terms that methods share: the 3DGS photometric loss, thermal smoothness in both readings, min-max normalisation.

Images are (H, W, C) in [0, 1]. Float32 on the CPU goes through fused kernels that give value and gradient together;
other types and devices through torch. Gradients reach the first argument only.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu.losses.minmax import inverse_depth, inverse_depth_gradient, normalise, normalise_gradient
from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient
from tdgbench.splats.cpu.losses.smoothness import differences_and_gradient

WINDOW, SIGMA = 11, 1.5
C1, C2 = 0.01**2, 0.03**2
MIN_RANGE = 1e-8


def l1(image: Tensor, target: Tensor) -> Tensor:
    """Mean absolute error."""
    return l1_and_dssim(image, target, 1.0, 0.0)


def ssim(image: Tensor, target: Tensor) -> Tensor:
    """Mean SSIM with zero padding, as 3DGS trains with."""
    return 1.0 - l1_and_dssim(image, target, 0.0, 1.0)


def photometric(image: Tensor, target: Tensor, lambda_ssim: float) -> Tensor:
    """(1 − λ) L1 + λ (1 − SSIM): 3DGS, eq. 7."""
    return l1_and_dssim(image, target, 1 - lambda_ssim, lambda_ssim)


def thermal(image: Tensor, target: Tensor, lambda_ssim: float, lambda_smooth: float, reading: str) -> Tensor:
    """Thermal loss (TDg, eq. 5, after ThermalGaussian): L1, SSIM and smoothness in one of its readings."""
    if not _is_fused(image):
        loss = photometric(image, target, lambda_ssim)
        return loss + lambda_smooth * smoothness(image, reading) if lambda_smooth > 0 else loss
    wrap, value_scale, gradient_scale = _smoothness_scales(image, reading)
    return _fused(
        image, target, 1 - lambda_ssim, lambda_ssim, wrap, lambda_smooth * value_scale, lambda_smooth * gradient_scale
    )


def l1_and_dssim(image: Tensor, target: Tensor, l1_weight: float, dssim_weight: float) -> Tensor:
    """l1_weight · L1 + dssim_weight · (1 − SSIM) of two images. Raises ValueError if their shapes differ."""
    if not _is_fused(image):
        _check_shapes(image, target)
        target = target.detach()
        error = (image - target).abs().mean()
        return l1_weight * error + dssim_weight * (1 - ssim_map(image, target).mean())
    return _fused(image, target, l1_weight, dssim_weight)


def _fused(
    image: Tensor,
    target: Tensor,
    l1_weight: float,
    dssim_weight: float,
    wrap: bool = False,
    smooth_value: float = 0.0,
    smooth_gradient: float = 0.0,
) -> Tensor:
    """One pass for L1, SSIM and smoothness; raises ValueError if the shapes differ."""
    _check_shapes(image, target)
    other = _array(target)

    def compute(a: np.ndarray) -> tuple[float, np.ndarray]:
        error, similarity, differences, gradient = photometric_and_gradient(
            a, other, l1_weight, -dssim_weight, smooth_gradient, wrap
        )
        return l1_weight * error + dssim_weight * (1 - similarity) + smooth_value * differences, gradient

    return _ValueAndGradient.apply(image, compute)


def _check_shapes(image: Tensor, target: Tensor) -> None:
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {tuple(image.shape)} and {tuple(target.shape)}")


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


def smoothness(image: Tensor, reading: str) -> Tensor:
    """How much neighbouring pixels differ, in one of the two readings that differ in their numbers.

    `paper` (TDg, eq. 6): sum over the 4 neighbours inside the image, divided by 4 M (M: pixels and channels).
    `reference` (ThermalGaussian's code): not divided by 4, neighbours wrap around at the border and are constants.
    """
    wrap, value_scale, gradient_scale = _smoothness_scales(image, reading)
    if not _is_fused(image):
        return _smoothness_in_torch(image, reading)

    def compute(a: np.ndarray) -> tuple[float, np.ndarray]:
        total, gradient = differences_and_gradient(a, wrap)
        return value_scale * total, np.float32(gradient_scale) * gradient

    return _ValueAndGradient.apply(image, compute)


def _smoothness_scales(image: Tensor, reading: str) -> tuple[bool, float, float]:
    """Whether neighbours wrap around, and by what the sum over pairs and its gradient are multiplied.

    Each pair is met from both sides. Constant neighbours halve the gradient.
    """
    if reading not in ("paper", "reference"):
        raise ValueError(f"smoothness reading is {reading!r}; it must be 'paper' or 'reference'")
    if reading == "reference":
        return True, 2 / image.numel(), 1 / image.numel()
    return False, 2 / (4 * image.numel()), 2 / (4 * image.numel())


def min_max(values: Tensor) -> Tensor:
    """Min-max normalisation of a map (H, W) to [0, 1] (TDg, before eq. 4), with the gradients of both extremes.

    A map without any range is all zeros, and its gradient is zero: there is nothing to compare.
    """
    if _is_fused(values):
        return _MinMax.apply(values)
    low, high = values.min(), values.max()
    if (high - low).item() < MIN_RANGE:
        return values * 0.0
    return (values - low) / (high - low)


def inverse_expected_depth(depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
    """1 / (expected z) = alpha / accumulated z, maps (H, W); 0, infinitely far, where alpha is not above min_alpha."""
    if _is_fused(depth):
        return _InverseDepth.apply(depth, transmittance, min_alpha)
    alpha = 1.0 - transmittance
    solid = alpha > min_alpha
    return torch.where(solid, alpha / torch.where(solid, depth, 1.0), 0.0)


def _is_fused(tensor: Tensor) -> bool:
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy())


def _smoothness_in_torch(image: Tensor, reading: str) -> Tensor:
    if reading == "paper":
        down = (image[1:] - image[:-1]).abs().sum()
        right = (image[:, 1:] - image[:, :-1]).abs().sum()
        return 2 * (down + right) / (4 * image.numel())
    still = image.detach()
    neighbours = [still.roll(shift, dim) for dim in (0, 1) for shift in (1, -1)]
    total = torch.stack([(image - neighbour).abs().sum() for neighbour in neighbours]).sum()
    return total / image.numel()


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


class _ValueAndGradient(torch.autograd.Function):
    """A scalar whose gradient is computed together with it."""

    @staticmethod
    def forward(ctx, image: Tensor, compute: Callable[[np.ndarray], tuple[float, np.ndarray]]) -> Tensor:
        value, gradient = compute(_array(image))
        ctx.gradient = torch.from_numpy(gradient)
        return torch.tensor(value, dtype=torch.float32)

    @staticmethod
    def backward(ctx, grad):
        return grad * ctx.gradient, None


class _MinMax(torch.autograd.Function):
    @staticmethod
    def forward(ctx, values: Tensor) -> Tensor:
        result = normalise(_array(values), MIN_RANGE)
        ctx.normalised, ctx.inverse_range = (None, 0.0) if result is None else result
        return torch.zeros_like(values) if result is None else torch.from_numpy(result[0])

    @staticmethod
    def backward(ctx, grad):
        if ctx.normalised is None:
            return torch.zeros_like(grad)
        return torch.from_numpy(normalise_gradient(_array(grad), ctx.normalised, ctx.inverse_range))


class _InverseDepth(torch.autograd.Function):
    @staticmethod
    def forward(ctx, depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
        ctx.inputs = (_array(depth), _array(transmittance), min_alpha)
        return torch.from_numpy(inverse_depth(*ctx.inputs))

    @staticmethod
    def backward(ctx, grad):
        by_depth, by_transmittance = inverse_depth_gradient(_array(grad), *ctx.inputs)
        return torch.from_numpy(by_depth), torch.from_numpy(by_transmittance), None

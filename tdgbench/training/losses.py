"""Loss terms that methods share: the 3DGS photometric loss, thermal smoothness in both readings, min-max normalisation.

Images are (H, W, C) in [0, 1]; losses are scalars. Fused kernels compute value and gradient of float32 images on the
CPU, and of L1 and SSIM on a GPU that Warp can use; torch those of the others. Only the first argument gets a gradient.

A mask `valid`, bool (H, W), takes pixels out of a loss where it is false: they are 0 in both images, as with 3DGS
(`alpha_mask` in train.py), nerfstudio (splatfacto.py) and gsplat (examples/simple_trainer.py), and means are over the
others, while there they are over all. None: every pixel counts. A loss raises ValueError if no pixel is valid.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu.losses.minmax import inverse_depth, inverse_depth_gradient, normalise, normalise_gradient
from tdgbench.splats.cpu.losses.photometric import Target, photometric_and_gradient, prepare_target
from tdgbench.splats.cpu.scratch import free_buffers
from tdgbench.splats.warp import fuses
from tdgbench.training import torch_losses

MANY = 1_000_000  # Gaussians
CACHE_BYTES = 192 * 2**20  # of filtered images: 80 views of 640 × 480 px with one channel, or 40 with depth priors
MIN_RANGE = 1e-8  # of a map that min-max normalisation stretches


class Smoothness(NamedTuple):
    """Factors of the sum of differences over pairs of neighbours, and of its gradient."""

    wrap: bool = False  # neighbours wrap around at the border
    value: float = 0.0
    gradient: float = 0.0


NO_SMOOTHNESS = Smoothness()


def l1(image: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return the mean absolute error of images (H, W, C).

    >>> l1(torch.full((4, 4, 1), 0.75), torch.full((4, 4, 1), 0.5)).item()
    0.25
    """
    return l1_and_dssim(image, target, 1.0, 0.0, valid)


def ssim(image: Tensor, target: Tensor, valid: Tensor | None = None) -> Tensor:
    """Return the mean SSIM of images (H, W, C) with zero padding, as in 3DGS.

    >>> image = torch.rand(16, 16, 3)
    >>> round(ssim(image, image).item(), 4)
    1.0
    """
    return 1.0 - l1_and_dssim(image, target, 0.0, 1.0, valid)


def photometric(image: Tensor, target: Tensor, lambda_ssim: float, valid: Tensor | None = None) -> Tensor:
    """Return (1 − λ) L1 + λ (1 − SSIM) of images (H, W, C): 3DGS, eq. 7."""
    return l1_and_dssim(image, target, 1 - lambda_ssim, lambda_ssim, valid)


def thermal_loss(
    image: Tensor, target: Tensor, lambda_ssim: float, lambda_smooth: float, reading: str, valid: Tensor | None = None
) -> Tensor:
    """Return the thermal loss (TDg, eq. 5, after ThermalGaussian) of images (H, W, C).

    (1 − λ_ssim) L1 + λ_ssim (1 − SSIM) + λ_smooth L_smooth, the last in one of the readings of `smoothness`.

    >>> image = torch.full((8, 8, 1), 0.5)
    >>> round(thermal_loss(image, image - 0.25, 0.0, 0.6, "written").item(), 4)
    0.25
    """
    if not _is_fused(image):
        loss = photometric(image, target, lambda_ssim, valid)
        return loss + lambda_smooth * smoothness(image, reading, valid) if lambda_smooth > 0 else loss
    scales = _smoothness_scales(image, reading, valid)
    smooth = Smoothness(scales.wrap, lambda_smooth * scales.value, lambda_smooth * scales.gradient)
    return _fused(image, target, 1 - lambda_ssim, lambda_ssim, smooth, valid)


def l1_and_dssim(
    image: Tensor, target: Tensor, l1_weight: float, dssim_weight: float, valid: Tensor | None = None
) -> Tensor:
    """Return l1_weight · L1 + dssim_weight · (1 − SSIM) of images (H, W, C); raise ValueError if the shapes differ."""
    if _is_fused(image):
        return _fused(image, target, l1_weight, dssim_weight, valid=valid)
    _check_shapes(image, target, valid)
    count = _valid_values(image, valid)
    if fuses(image):
        return _on_warp(image, target, (l1_weight, dssim_weight), valid, count)
    return torch_losses.l1_and_dssim(image, target, l1_weight, dssim_weight, valid)


def _on_warp(image: Tensor, target: Tensor, weights: tuple[float, float], valid: Tensor | None, count: int) -> Tensor:
    """Return L1 and SSIM by the kernels of the `warp` backend. weights: of both; count: values that are valid."""
    from tdgbench.splats.warp.losses import L1AndDssim

    if valid is None:
        return L1AndDssim.apply(image, target.detach(), image.new_empty(0, 0), weights, count)
    image, target = (torch_losses.without_masked(t, valid) for t in (image, target.detach()))
    return L1AndDssim.apply(image, target, valid.to(image.dtype), weights, count)


def _fused(
    image: Tensor,
    target: Tensor,
    l1_weight: float,
    dssim_weight: float,
    smooth: Smoothness = NO_SMOOTHNESS,
    valid: Tensor | None = None,
) -> Tensor:
    """Return L1, SSIM and smoothness in one pass. Raises ValueError if the shapes differ."""
    _check_shapes(image, target, valid)
    prepared = _PREPARED.of(target, valid)

    def compute(a: np.ndarray) -> tuple[float, np.ndarray]:
        error, similarity, differences, gradient = photometric_and_gradient(
            a, prepared, l1_weight, -dssim_weight, smooth.gradient, smooth.wrap
        )
        return l1_weight * error + dssim_weight * (1 - similarity) + smooth.value * differences, gradient

    return _ValueAndGradient.apply(image, compute)


def _check_shapes(image: Tensor, target: Tensor, valid: Tensor | None) -> None:
    if image.shape != target.shape:
        raise ValueError(f"the images to compare are {tuple(image.shape)} and {tuple(target.shape)}")
    if valid is not None and valid.shape != image.shape[:2]:
        raise ValueError(f"the mask is {tuple(valid.shape)}, the images to compare are {tuple(image.shape)}")


def _valid_values(image: Tensor, valid: Tensor | None) -> int:
    """Return the number of values of an image (H, W, C) that count."""
    if valid is None:
        return image.numel()
    count = _VALID_PIXELS.of(valid) * image.shape[2]
    if not count:
        raise ValueError("no pixel of the image is valid, so that it has no loss")
    return count


def smoothness(image: Tensor, reading: str, valid: Tensor | None = None) -> Tensor:
    """Return the mean difference of neighbouring pixels of an image (H, W, C), in one of two readings.

    `written` (TDg, eq. 6): sum over the 4 neighbours inside the image, divided by 4 M (M: pixels and channels).
    `released` (ThermalGaussian's code): not divided by 4; neighbours wrap around at the border and are constants.
    With a mask, the sum is over neighbours that are both valid, and M counts valid pixels.

    >>> image = torch.tensor([[[0.0], [1.0]]])
    >>> smoothness(image, "written").item(), smoothness(image, "released").item()
    (0.25, 2.0)
    """
    _check_reading(reading)
    return torch_losses.smoothness(image, reading, valid, _valid_values(image, valid))


def _check_reading(reading: str) -> None:
    if reading not in ("written", "released"):
        raise ValueError(f"smoothness reading is {reading!r}; it must be 'written' or 'released'")


def _smoothness_scales(image: Tensor, reading: str, valid: Tensor | None) -> Smoothness:
    """Return the factors of a reading. Each pair counts for both its pixels; constant neighbours halve the gradient."""
    _check_reading(reading)
    count = _valid_values(image, valid)
    if reading == "released":
        return Smoothness(True, 2 / count, 1 / count)
    return Smoothness(False, 2 / (4 * count), 2 / (4 * count))


def min_max(values: Tensor) -> Tensor:
    """Normalise a map (H, W) to [0, 1] by its extremes (TDg, before eq. 4), which get gradients, too.

    A map without range becomes zero, with zero gradient.

    >>> min_max(torch.tensor([[1.0, 2.0], [3.0, 5.0]])).tolist()
    [[0.0, 0.25], [0.5, 1.0]]
    """
    if _is_fused(values):
        return _MinMax.apply(values)
    low, high = values.min(), values.max()
    is_flat = high - low < MIN_RANGE
    return torch.where(is_flat, 0.0, values - low) / torch.where(is_flat, 1.0, high - low)


def inverse_expected_depth(depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
    """Return 1 / (expected z) = alpha / accumulated z, maps (H, W); 0, infinitely far, where alpha ≤ min_alpha.

    >>> inverse_expected_depth(torch.tensor([[1.0, 0.0]]), torch.tensor([[0.5, 1.0]]), 1e-3).tolist()
    [[0.5, 0.0]]
    """
    if _is_fused(depth):
        return _InverseDepth.apply(depth, transmittance, min_alpha)
    alpha = 1.0 - transmittance
    solid = alpha > min_alpha
    return torch.where(solid, alpha / torch.where(solid, depth, 1.0), 0.0)


def _is_fused(tensor: Tensor) -> bool:
    return tensor.device.type == "cpu" and tensor.dtype == torch.float32


def _array(tensor: Tensor) -> np.ndarray:
    return np.ascontiguousarray(tensor.detach().numpy())


class _ValueAndGradient(torch.autograd.Function):
    """Scalar that is computed together with its gradient."""

    @staticmethod
    def forward(ctx, image: Tensor, compute: Callable[[np.ndarray], tuple[float, np.ndarray]]) -> Tensor:
        value, gradient = compute(_array(image))
        ctx.gradient = torch.from_numpy(gradient)
        return torch.scalar_tensor(value, dtype=torch.float32)

    @staticmethod
    def backward(ctx, grad):
        # as it is, if nothing scales it: autograd does not write into what ctx holds, too
        return ctx.gradient if grad.item() == 1 else grad * ctx.gradient, None


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


class _Prepared(NamedTuple):
    version: tuple[int, int | None]  # torch's counts of writes to image and mask
    valid: Tensor | None
    target: Target

    @property
    def bytes(self) -> int:
        """Memory beyond that of the image and its mask."""
        target = self.target
        return target.filtered.nbytes + (0 if target.weights is None else target.weights.nbytes + target.image.nbytes)


class PreparedTargets:
    """Prepared images by their tensors, up to a number of bytes; what exceeds it is prepared anew each time."""

    def __init__(self, max_bytes: int = CACHE_BYTES) -> None:
        self.max_bytes = max_bytes
        self.bytes = 0
        self._prepared: dict[int, _Prepared] = {}

    def of(self, image: Tensor, valid: Tensor | None) -> Target:
        """Return the image (H, W, C), prepared with a mask (H, W)."""
        stored = self._prepared.get(id(image))
        version = (image._version, None if valid is None else valid._version)
        if stored is not None and stored.valid is valid and stored.version == version:
            return stored.target
        new = _Prepared(version, valid, prepare_target(_array(image), None if valid is None else _array(valid)))
        growth = new.bytes - (0 if stored is None else stored.bytes)
        if self.bytes + growth <= self.max_bytes:
            self.bytes += growth
            self._prepared[id(image)] = new
            if stored is None:
                weakref.finalize(image, self._forget, id(image))
        return new.target

    def limit(self, max_bytes: int) -> None:
        """Change the number of bytes; where it is exceeded, forget all of them."""
        self.max_bytes = max_bytes
        if self.bytes > max_bytes:
            self._prepared.clear()
            self.bytes = 0
            free_buffers()

    def _forget(self, key: int) -> None:
        stored = self._prepared.pop(key, None)
        self.bytes -= 0 if stored is None else stored.bytes


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


_PREPARED, _VALID_PIXELS = PreparedTargets(), ValidPixels()


def keep_prepared(gaussians: int) -> None:
    """Keep prepared images while there are few Gaussians: with MANY, preparing them takes a hundredth of a step."""
    _PREPARED.limit(CACHE_BYTES if gaussians < MANY else 0)

"""Image losses on the CPU as functions of torch's autograd: fused kernels compute value and gradient together."""

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
from tdgbench.splats.torch_losses import MIN_RANGE, LossWeights, valid_values

MANY = 1_000_000  # Gaussians
CACHE_BYTES = 192 * 2**20  # of filtered images: 80 views of 640 × 480 px with one channel, or 40 with depth priors


def image_loss(image: Tensor, target: Tensor, weights: LossWeights, valid: Tensor | None) -> Tensor:
    """Return L1, 1 − SSIM and smoothness of float32 images, with their weights, in one pass."""
    prepared, smooth = _PREPARED.of(target, valid), _smoothness_factors(image, weights, valid)

    def compute(a: np.ndarray) -> tuple[float, np.ndarray]:
        error, similarity, differences, gradient = photometric_and_gradient(
            a, prepared, weights.l1, -weights.dssim, smooth.gradient, smooth.wrap
        )
        return weights.l1 * error + weights.dssim * (1 - similarity) + smooth.value * differences, gradient

    return _ValueAndGradient.apply(image, compute)


class _SmoothnessFactors(NamedTuple):
    """Factors of the sum of differences over pairs of neighbours, and of its gradient."""

    wrap: bool  # neighbours wrap around at the border
    value: float
    gradient: float


def _smoothness_factors(image: Tensor, weights: LossWeights, valid: Tensor | None) -> _SmoothnessFactors:
    """Return the factors of a reading. Each pair counts for both its pixels; constant neighbours halve the gradient."""
    if weights.smooth == 0:
        return _SmoothnessFactors(False, 0.0, 0.0)
    count = valid_values(image, valid)
    if weights.reading == "released":
        return _SmoothnessFactors(True, weights.smooth * (2 / count), weights.smooth * (1 / count))
    return _SmoothnessFactors(False, weights.smooth * (2 / (4 * count)), weights.smooth * (2 / (4 * count)))


def min_max(values: Tensor) -> Tensor:
    """`torch_losses.min_max` of a float32 map."""
    return _MinMax.apply(values)


def inverse_expected_depth(depth: Tensor, transmittance: Tensor, min_alpha: float) -> Tensor:
    """`torch_losses.inverse_expected_depth` of float32 maps."""
    return _InverseDepth.apply(depth, transmittance, min_alpha)


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
    """Prepared images by their tensors, up to a number of bytes; further images are prepared anew each time."""

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


_PREPARED = PreparedTargets()


def keep_prepared(gaussians: int) -> None:
    """Keep prepared images while there are few Gaussians: with MANY, preparing them takes a hundredth of a step."""
    _PREPARED.limit(CACHE_BYTES if gaussians < MANY else 0)

"""Response of a thermal camera to a rendered image, with its gradients in closed form.

The vignette is a sum of products of polynomials in x and y. So its map, and the sums of an image's gradient with all of
them, need a few numbers for each row and column. Fused kernels compute those of float32 on the CPU, torch the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu.losses.response import respond, respond_backward
from tdgbench.thermal.polynomials import DEGREE, TERMS, along

MOST_SIZES = 64  # of images, whose polynomials are kept
ACROSS, DOWN = (torch.tensor(degrees) for degrees in zip(*TERMS, strict=True))  # of each coefficient


class Sums(NamedTuple):
    """Gradient of a loss by a response: sums over the pixels of an image."""

    offset: float
    gain: float
    vignette: Tensor  # (K,) float64


class _Polynomials(NamedTuple):
    """Orthonormal Legendre polynomials at an image's columns and rows, and their means."""

    across: Tensor  # (W, DEGREE + 1)
    down: Tensor  # (H, DEGREE + 1)
    means: Tensor  # (DEGREE + 1, DEGREE + 1) of the products over the image, by the degrees in y and x


@dataclass(frozen=True)
class Response:
    """shown = T + (gain − 1) (T − reference) + offset + vignette. vignette: (K,) coefficients, float64."""

    offset: float
    gain: float
    reference: float
    vignette: Tensor

    def of(self, image: Tensor) -> Tensor:
        """What the camera shows of an image (H, W, C), the same response in all channels."""
        if not is_fast(image):
            return torch.add(self.added(image)[..., None], image, alpha=self.gain)
        height, width, channels = image.shape
        polynomials = _polynomials(width, height, image.dtype, image.device)
        rows = (polynomials.down @ self._weights(polynomials.means).to(image)).numpy()
        shown = respond(flat_rows(image), self.gain, rows, _columns(width, height, channels))
        return torch.from_numpy(shown).view(image.shape)

    def added(self, image: Tensor) -> Tensor:
        """What is added to gain · T in an image of this size, (H, W)."""
        across, down, means = _polynomials(image.shape[1], image.shape[0], image.dtype, image.device)
        return down @ self._weights(means).to(image) @ across.T

    def _weights(self, means: Tensor) -> Tensor:
        """Weights of the products of polynomials in what is added, by the degrees in y and x; the first is constant."""
        weights = torch.zeros(DEGREE + 1, DEGREE + 1, dtype=torch.float64)
        weights[DOWN, ACROSS] = self.vignette
        weights[0, 0] = self.offset + (1 - self.gain) * self.reference - float((weights * means).sum())
        return weights

    def gradient(self, image: Tensor, grad: Tensor) -> tuple[Tensor, Sums]:
        """Gradient by an image (H, W, C), and sums, for the gradient (H, W, C) of a loss by what is shown of it."""
        height, width, channels = image.shape
        across, down, means = _polynomials(width, height, image.dtype, image.device)
        if is_fast(image) and is_fast(grad):
            columns = _columns(width, height, channels)
            by_image, sums = respond_backward(flat_rows(image), flat_rows(grad), self.gain, columns)
            result = torch.from_numpy(by_image).view(image.shape)
            total, by_value = float(sums[:, 0].sum()), float(sums[:, -1].sum())
            by_degrees = down.double().T @ torch.from_numpy(sums[:, :-1])
        else:
            flat = grad[..., 0] if channels == 1 else grad.sum(dim=2)
            result, total, by_value = self.gain * grad, float(flat.sum()), float((grad * image).sum())
            by_degrees = (down.T @ (flat @ across)).to("cpu", torch.float64)
        return result, Sums(total, by_value - self.reference * total, (by_degrees - total * means)[DOWN, ACROSS])


def is_fast(image: Tensor) -> bool:
    """Whether kernels compute the response to an image."""
    return image.device.type == "cpu" and image.dtype == torch.float32


def flat_rows(image: Tensor) -> np.ndarray:
    """An image (H, W, C) as the kernels take it, (H, W · C)."""
    return np.ascontiguousarray(image.detach().numpy()).reshape(image.shape[0], -1)


def shown(image: Tensor, response: Response, collect: Callable[[Sums], None]) -> Tensor:
    """`response.of(image)`; its backward pass gives the image's gradient on, and the response's to `collect`."""
    result: Tensor = _Shown.apply(image, response, collect)
    return result


def best_fit(
    image: Tensor, target: Tensor, valid: Tensor | None, response: Response, *,
    fits_gain: bool = True, fits_offset: bool = True,
) -> Response:  # fmt: skip
    """The response with the gain ≥ 0 and offset that bring an image (H, W, C) nearest to a target by least squares.

    valid: (H, W) bool, the pixels that count; None: all. The vignette stays, the gain is 1 unless `fits_gain`, and the
    offset 0 unless `fits_offset`. An image of one value gets gain 1.

    >>> ideal = Response(0.0, 1.0, 0.5, torch.zeros(len(TERMS), dtype=torch.float64))
    >>> image = torch.tensor([0.2, 0.4, 0.6]).reshape(1, 3, 1)
    >>> found = best_fit(image, 0.5 * image + 0.3, None, ideal)
    >>> round(found.gain, 4), round(found.offset, 4)
    (0.5, 0.05)
    """
    flat = Response(0.0, 1.0, 0.0, response.vignette)
    x, y = image.double(), target.double() - flat.added(image.double())[..., None]
    if valid is not None:
        x, y = x[valid], y[valid]
    middle, level = (float(x.mean()), float(y.mean())) if fits_offset else (response.reference, response.reference)
    spread = float((x - middle).square().mean())
    gain = max(float(((x - middle) * (y - level)).mean()) / spread, 0.0) if fits_gain and spread > 0 else 1.0
    offset = level - response.reference - gain * (middle - response.reference)
    return Response(offset, gain, response.reference, response.vignette)


class _Shown(torch.autograd.Function):
    @staticmethod
    def forward(ctx, image: Tensor, response: Response, collect: Callable[[Sums], None]) -> Tensor:
        ctx.save_for_backward(image)
        ctx.response, ctx.collect = response, collect
        return response.of(image)

    @staticmethod
    def backward(ctx, grad):
        (image,) = ctx.saved_tensors
        by_image, sums = ctx.response.gradient(image, grad)
        ctx.collect(sums)
        return by_image, None, None


@lru_cache(maxsize=MOST_SIZES)
def _columns(width: int, height: int, channels: int) -> np.ndarray:
    """The polynomials at an image's columns, as the kernels take them: (DEGREE + 1, W · C)."""
    across = _polynomials(width, height, torch.float32, torch.device("cpu")).across.numpy()
    return np.ascontiguousarray(across.T.repeat(channels, axis=1))


@lru_cache(maxsize=MOST_SIZES)
def _polynomials(width: int, height: int, dtype: torch.dtype, device: torch.device) -> _Polynomials:
    across, down = (along((np.arange(size) + 0.5) / size) for size in (width, height))
    means = torch.from_numpy(np.outer(down.mean(axis=0), across.mean(axis=0)))
    return _Polynomials(
        torch.from_numpy(across).to(device, dtype), torch.from_numpy(down).to(device, dtype), means
    )  # fmt: skip

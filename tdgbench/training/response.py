"""Response of a thermal camera to a rendered image, with its gradients in closed form.

The vignette is a sum of products of polynomials in x and y. So its map, and the sums of an image's gradient with all of
them, are two small matrix products each; everything else is one pass over the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import torch
from numpy.polynomial.legendre import legvander
from torch import Tensor

from tdgbench.thermal.polynomials import DEGREE, TERMS

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
        return torch.add(self.added(image)[..., None], image, alpha=self.gain)

    def added(self, image: Tensor) -> Tensor:
        """What is added to gain · T in an image of this size, (H, W)."""
        across, down, means = _polynomials(image.shape[1], image.shape[0], image.dtype, image.device)
        weights = torch.zeros(DEGREE + 1, DEGREE + 1, dtype=torch.float64)
        weights[DOWN, ACROSS] = self.vignette
        constant = self.offset + (1 - self.gain) * self.reference - float((weights * means).sum())
        return (down @ weights.to(image) @ across.T).add_(constant)

    def gradient(self, image: Tensor, grad: Tensor) -> Sums:
        """Sums for the gradient (H, W, C) of a loss by what is shown of an image (H, W, C)."""
        across, down, means = _polynomials(image.shape[1], image.shape[0], image.dtype, image.device)
        flat = grad[..., 0] if grad.shape[2] == 1 else grad.sum(dim=2)
        total = float(flat.sum())
        by_degrees = (down.T @ (flat @ across)).to("cpu", torch.float64) - total * means
        by_gain = float((grad * image).sum()) - self.reference * total
        return Sums(total, by_gain, by_degrees[DOWN, ACROSS])


def shown(image: Tensor, response: Response, collect: Callable[[Sums], None]) -> Tensor:
    """`response.of(image)`; its backward pass gives the image's gradient on, and the response's to `collect`."""
    result: Tensor = _Shown.apply(image, response, collect)
    return result


def best_fit(
    image: Tensor, target: Tensor, valid: Tensor | None, response: Response, *, fits_gain: bool = True
) -> Response:
    """The response with the gain ≥ 0 and offset that bring an image (H, W, C) nearest to a target by least squares.

    valid: (H, W) bool, the pixels that count; None: all. The vignette stays, and the gain is 1 unless `fits_gain`. An
    image of one value gets gain 1.

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
    middle, level = float(x.mean()), float(y.mean())
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
        ctx.collect(ctx.response.gradient(image, grad))
        return ctx.response.gain * grad, None, None


@lru_cache(maxsize=MOST_SIZES)
def _polynomials(width: int, height: int, dtype: torch.dtype, device: torch.device) -> _Polynomials:
    scale = np.sqrt(2 * np.arange(DEGREE + 1) + 1)
    across, down = (legvander(2 * (np.arange(size) + 0.5) / size - 1, DEGREE) * scale for size in (width, height))
    means = torch.from_numpy(np.outer(down.mean(axis=0), across.mean(axis=0)))
    return _Polynomials(
        torch.from_numpy(across).to(device, dtype), torch.from_numpy(down).to(device, dtype), means
    )  # fmt: skip

"""Where rays are sampled: intervals in a spacing, redrawn where proposals have weight (Barron et al. 2022, §3, 4)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

HISTOGRAM_PADDING = 0.01  # weight that each interval gets in addition, so that none is never sampled again
EPS = 1e-7


@dataclass(frozen=True)
class Spacing:
    """Maps places in [0, 1] to depths from `near` to `far`, both of them > 0; beyond the depth `unit`, steps grow."""

    near: float
    far: float
    unit: float

    def depths(self, places: Tensor) -> Tensor:
        """Return the depths of places, any shape."""
        return self.unit * self.depth_at(self.place_of(self.near / self.unit) + self.extent * places)

    @property
    def extent(self) -> float:
        """The distance from `near` to `far` on the spacing's own axis."""
        return self.place_of(self.far / self.unit) - self.place_of(self.near / self.unit)

    def place_of(self, depth: float) -> float:
        """Return the place of a depth in units, on an axis of the spacing's own."""
        raise NotImplementedError

    def depth_at(self, place: Tensor) -> Tensor:
        """Return the depths, in units, of places on that axis."""
        raise NotImplementedError


class DisparitySpacing(Spacing):
    """Linear up to `unit`, in disparity beyond, as nerfacto's sampler.

    >>> spacing = DisparitySpacing(near=0.5, far=8.0, unit=2.0)
    >>> spacing.depths(torch.tensor([0.0, 0.5, 1.0]))
    tensor([0.5000, 2.0000, 8.0000])
    """

    def place_of(self, depth: float) -> float:
        return depth / 2 if depth < 1 else 1 - 1 / (2 * depth)

    def depth_at(self, place: Tensor) -> Tensor:
        return torch.where(place < 0.5, 2 * place, 1 / (2 - 2 * place).clamp_min(EPS))


class SteadySpacing(Spacing):
    """Even steps up to `unit`, in proportion to depth beyond, as torch-ngp's.

    >>> SteadySpacing(near=0.5, far=2 * math.e, unit=2.0).depths(torch.tensor([0.0, 3 / 7, 1.0]))
    tensor([0.5000, 2.0000, 5.4366])
    """

    def place_of(self, depth: float) -> float:
        return depth if depth < 1 else 1 + math.log(depth)

    def depth_at(self, place: Tensor) -> Tensor:
        return torch.where(place < 1, place, (place - 1).exp())


def stratified_edges(rays: int, count: int, generator: torch.Generator | None) -> Tensor:
    """Return the edges (rays, count + 1) in [0, 1] of `count` intervals: even ones that are shifted, as nerfstudio's.

    generator: of one shift for each ray, by up to half an interval, from 0 inwards and from 1 inwards; None: no shift.
    """
    even = torch.linspace(0, 1, count + 1)
    if generator is None:
        return even.expand(rays, -1)
    middles = (even[1:] + even[:-1]) / 2
    first, last = torch.cat([even[:1], middles]), torch.cat([middles, even[-1:]])
    return first + (last - first) * torch.rand(rays, 1, generator=generator)


def resampled_edges(edges: Tensor, weights: Tensor, count: int, generator: torch.Generator | None) -> Tensor:
    """Return the edges (R, count + 1) of intervals that each have an equal share of a piecewise constant density.

    edges: (R, S + 1), ascending. weights: (R, S) of the intervals, to which HISTOGRAM_PADDING is added. generator: of
    one shift for each ray; None: no shift. No gradient flows through them.
    """
    weights = weights.detach() + HISTOGRAM_PADDING
    shares = weights / weights.sum(dim=1, keepdim=True)
    cdf = functional.pad(torch.cumsum(shares, dim=1), (1, 0)).clamp(max=1.0)
    quantiles = torch.linspace(0, 1 - 1 / (count + 1), count + 1, device=weights.device, dtype=weights.dtype)
    shift = 0.5 if generator is None else torch.rand(len(weights), 1, generator=generator).to(weights)
    quantiles = (quantiles + shift / (count + 1)).expand(len(weights), -1).contiguous()
    right = torch.searchsorted(cdf, quantiles, right=True).clamp(1, weights.shape[1])
    low, high = cdf.gather(1, right - 1), cdf.gather(1, right)
    start, end = edges.gather(1, right - 1), edges.gather(1, right)
    return start + ((quantiles - low) / (high - low).clamp_min(EPS)).clamp(0, 1) * (end - start)


def interlevel_loss(edges: Tensor, weights: Tensor, proposed: Tensor, proposed_weights: Tensor) -> Tensor:
    """Return the loss of a proposal that bounds too little of the final weights (Barron et al. 2022, eq. 13).

    edges (R, S + 1) and weights (R, S): of the final samples; no gradient flows to them. proposed, proposed_weights:
    likewise (R, P + 1) and (R, P) of the proposal. The mean over all samples, as in Barron et al.'s code.
    """
    edges, weights = edges.detach(), weights.detach()
    total = functional.pad(torch.cumsum(proposed_weights, dim=1), (1, 0))
    place = proposed.detach().contiguous()
    last = proposed_weights.shape[1]
    first = (torch.searchsorted(place, edges[:, :-1].contiguous(), right=True) - 1).clamp(0, last)
    behind = torch.searchsorted(place, edges[:, 1:].contiguous(), right=False).clamp(0, last)
    bound = total.gather(1, behind) - total.gather(1, first)
    return ((weights - bound).clamp_min(0).square() / (weights + EPS)).mean()


def distortion_loss(edges: Tensor, weights: Tensor) -> Tensor:
    """Return the distortion of samples (Barron et al. 2022, eq. 15), mean over rays; edges (R, S + 1), weights (R, S).

    Σ_ij w_i w_j |m_i − m_j| + ⅓ Σ_i w_i² δ_i; the double sum in linear time, since the centres m ascend.
    """
    centers, lengths = (edges[:, 1:] + edges[:, :-1]) / 2, edges.diff(dim=1)
    moments = weights * centers
    before = torch.cumsum(weights, dim=1) - weights
    moments_before = torch.cumsum(moments, dim=1) - moments
    pairs = 2 * (moments * before - weights * moments_before).sum(dim=1)
    return (pairs + (weights.square() * lengths).sum(dim=1) / 3).mean()

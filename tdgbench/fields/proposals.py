"""Proposal networks: small density fields that say where the samples of a ray belong (Barron et al. 2022, §3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from tdgbench.fields.contraction import Region
from tdgbench.fields.density import DensityField
from tdgbench.fields.rays import Rays
from tdgbench.fields.sampling import DisparitySpacing, Spacing, interlevel_loss, resampled_edges, stratified_edges
from tdgbench.fields.volume import weights_of

ANNEALING_SLOPE = 10.0  # Barron et al. 2022, supplement (eq. 18)


class Samples(NamedTuple):
    """Intervals along rays, and their middles."""

    places: Tensor  # (R, S + 1) edges of the intervals in the spacing, [0, 1]
    lengths: Tensor  # (R, S) of the intervals, in radii of the region
    depths: Tensor  # (R, S) of the middles
    contracted: Tensor  # (R · S, 3) positions of the middles in the region
    extent: float  # of the spacing, see `Spacing`

    def weights(self, densities: Tensor) -> Tensor:
        """Return the weights (R, S) of densities (R · S,)."""
        return weights_of(densities.view_as(self.lengths), self.lengths)


Proposed = tuple[Tensor, Tensor]  # places (R, P + 1) of a proposal's samples, and their weights (R, P)


class Sampler(nn.Module):
    """Samples rays evenly in a spacing, then where each proposal in turn has weight."""

    def __init__(self, proposals: Sequence[DensityField], counts: Sequence[int]) -> None:
        """counts: samples of a ray for each proposal, and for the field."""
        super().__init__()
        self.proposals, self.counts = nn.ModuleList(proposals), tuple(counts)

    def forward(
        self,
        rays: Rays,
        region: Region,
        generator: torch.Generator | None = None,
        annealing: float = 1.0,
        learns: bool = False,
    ) -> tuple[Samples, list[Proposed]]:
        """Return the samples for the field, and what was proposed.

        generator: of jitter; None: none. annealing: exponent of the proposals' weights (`annealed`). learns: whether
        gradients will flow to the proposals.
        """
        spacing, proposed = DisparitySpacing(region.near, region.far, region.radius), []
        places = stratified_edges(len(rays.origins), self.counts[0], generator).to(rays.origins)
        for proposal, count in zip(self.proposals, self.counts[1:], strict=True):
            with torch.set_grad_enabled(learns and torch.is_grad_enabled()):
                samples = samples_at(places, rays, region, spacing)
                weights = samples.weights(proposal(samples.contracted)[0])
            proposed.append((places, weights))
            places = resampled_edges(places, weights.detach() ** annealing, count, generator)
        return samples_at(places, rays, region, spacing), proposed


def samples_at(places: Tensor, rays: Rays, region: Region, spacing: Spacing) -> Samples:
    """Return the samples between edges (R, S + 1) in a spacing."""
    edges = spacing.depths(places)
    lengths = edges.diff(dim=1) * (rays.directions.norm(dim=1, keepdim=True) / region.radius)
    depths = (edges[:, 1:] + edges[:, :-1]) / 2
    return Samples(places, lengths, depths, region.contracted(rays.at(depths).view(-1, 3)), spacing.extent)


def annealed(share: float) -> float:
    """Return the exponent of proposed weights after a share in [0, 1] of the annealing: 0 at first, 1 at its end.

    >>> [round(annealed(share), 2) for share in (0.0, 0.1, 1.0, 2.0)]
    [0.0, 0.53, 1.0, 1.0]
    """
    share = min(share, 1.0)
    return ANNEALING_SLOPE * share / ((ANNEALING_SLOPE - 1) * share + 1)


def proposal_loss(samples: Samples, weights: Tensor, proposed: Sequence[Proposed]) -> Tensor:
    """Return the sum of the interlevel losses of all proposals; weights (R, S): of the field."""
    losses = [interlevel_loss(samples.places, weights, *one) for one in proposed]
    return torch.stack(losses).sum()

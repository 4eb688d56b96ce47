"""Density fields: a hash grid with a small network, which gives density and features of a position."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from tdgbench.fields.hash_grid import HashGrid
from tdgbench.fields.kernels import FEATURES
from tdgbench.fields.networks import MLP, truncated_exp


@dataclass(frozen=True)
class GridOptions:
    """Size of a density field."""

    levels: int
    coarsest: int  # cells along an axis
    finest: int
    log2_rows: int  # of the largest table of a level
    hidden: int  # width of the network
    initial_density: float  # of the untrained field, about, per radius of the region
    layers: int = 1  # hidden ones of the network

    def __post_init__(self) -> None:
        if self.finest < self.coarsest:
            raise ValueError(f"the finest level has {self.finest} cells along an axis, the coarsest {self.coarsest}")


class DensityField(nn.Module):
    """Density of a position, per radius of the region, with features for the networks of colours (Müller et al. 2022).

    The first output of the network is the logarithm of the density.
    """

    def __init__(self, options: GridOptions, features: int, generator: torch.Generator) -> None:
        super().__init__()
        self.initial_density = options.initial_density
        self.grid = HashGrid(options.levels, options.coarsest, options.finest, options.log2_rows, generator)
        sizes = FEATURES * options.levels, *[options.hidden] * options.layers, 1 + features
        self.network = MLP(sizes, generator)

    def forward(self, contracted: Tensor) -> tuple[Tensor, Tensor]:
        """Return densities (N,) and features (N, F) of contracted positions (N, 3)."""
        out = self.network(self.grid(contracted))
        logarithm, features = out.split([1, out.shape[1] - 1], dim=1)
        return self.initial_density * truncated_exp(logarithm.squeeze(1)), features

"""Counts of the work that training a set of Gaussians took."""

from __future__ import annotations

from dataclasses import dataclass

from tdgbench.splats.density import DensityChange
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.pending import PendingGradients


@dataclass
class Work:
    """Sums over all backward passes and rounds of density control so far."""

    rows: int = 0  # Gaussians of the model
    touched: int = 0  # Gaussians with a gradient
    pairs: int = 0  # (tile, Gaussian) pairs
    blended: int = 0  # pairs that the blend read before their tile ended
    cloned: int = 0  # Gaussians
    split: int = 0
    pruned: int = 0
    withheld: int = 0

    def add(self, gradients: Gradients | PendingGradients, count: int) -> None:
        """Add the backward pass of a view of `count` Gaussians, but for those that it touched."""
        self.rows += count
        self.pairs += gradients.pairs
        self.blended += gradients.blended

    def add_change(self, change: DensityChange) -> None:
        """Add an iteration's density control."""
        self.cloned += change.cloned
        self.split += change.split
        self.pruned += change.pruned
        self.withheld += change.withheld

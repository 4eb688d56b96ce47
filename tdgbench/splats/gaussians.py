"""A set of 3-D Gaussians: five tensors, stored before their activations (3DGS, section 4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields

import torch
from torch import Tensor


@dataclass
class Gaussians:
    """N Gaussians with C channels (1: gray, 3: colour) and K = (degree + 1)² harmonics coefficients.

    The same shape of object also holds what belongs to each parameter, such as the optimiser's moments.
    """

    means: Tensor  # (N, 3) world coordinates
    log_scales: Tensor  # (N, 3) natural log of the standard deviations
    quats: Tensor  # (N, 4) wxyz, any length
    opacity_logits: Tensor  # (N,)
    sh: Tensor  # (N, K, C)

    @classmethod
    def names(cls) -> tuple[str, ...]:
        return tuple(field.name for field in fields(cls))

    def items(self) -> Iterable[tuple[str, Tensor]]:
        return [(name, getattr(self, name)) for name in self.names()]

    def __len__(self) -> int:
        return len(self.means)

    @property
    def scales(self) -> Tensor:
        return self.log_scales.exp()

    @property
    def opacities(self) -> Tensor:
        return self.opacity_logits.sigmoid()

    @property
    def channels(self) -> int:
        return self.sh.shape[2]

    @property
    def sh_degree(self) -> int:
        return round(self.sh.shape[1] ** 0.5) - 1

    def map(self, function: Callable[[Tensor], Tensor]) -> Gaussians:
        """The same function on every tensor."""
        return Gaussians(**{name: function(tensor) for name, tensor in self.items()})

    def select(self, index: Tensor | slice) -> Gaussians:
        """The Gaussians at an index, in a slice, or where a mask holds."""
        return self.map(lambda tensor: tensor[index])

    def zeros_like(self) -> Gaussians:
        return self.map(torch.zeros_like)

    def as_leaves(self) -> Gaussians:
        """Detached tensors that ask for gradients."""
        return self.map(lambda tensor: tensor.detach().contiguous().requires_grad_())

    def detach(self) -> Gaussians:
        return self.map(torch.Tensor.detach)


def concatenate(parts: list[Gaussians]) -> Gaussians:
    """All Gaussians of several sets, in order."""
    return Gaussians(**{name: torch.cat([getattr(p, name) for p in parts]) for name in Gaussians.names()})

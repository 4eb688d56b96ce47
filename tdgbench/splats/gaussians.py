"""A set of 3-D Gaussians: five tensors before their activations (3DGS, section 4), and further named fields."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields

import torch
from torch import Tensor

from tdgbench.splats.view import GaussianTensors

# Columns of a Gaussian's row of numbers: the layout that training and its gradients share.
MEANS_AT, QUATS_AT, SCALES_AT, OPACITY_AT, COLORS_AT = 0, 3, 7, 10, 11
GEOMETRY_SIZES = [3, 4, 3, 1]  # columns of each parameter before the colours
LINE = 16  # floats of a cache line
LEAST_COLUMNS = 16  # of rows in training: they fill the widest register


@dataclass
class Gaussians:
    """N Gaussians with C channels (1: gray, 3: colour) and K = (degree + 1)² harmonics coefficients.

    >>> one = Gaussians(
    ...     means=torch.zeros(1, 3), log_scales=torch.zeros(1, 3), quats=torch.tensor([[1.0, 0, 0, 0]]),
    ...     opacity_logits=torch.zeros(1), sh=torch.zeros(1, 4, 3),
    ... )
    >>> len(one), one.channels, one.sh_degree, one.opacities.item(), one.scales[0, 0].item()
    (1, 3, 1, 0.5, 1.0)
    """

    means: Tensor  # (N, 3) world coordinates
    log_scales: Tensor  # (N, 3) natural log of the standard deviations
    quats: Tensor  # (N, 4) wxyz, any length
    opacity_logits: Tensor  # (N,)
    sh: Tensor  # (N, K, C)
    extra_fields: dict[str, Tensor] = field(default_factory=dict)  # (N, ...), such as a second colour set

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Return the names of the five parameters that all Gaussians have."""
        return tuple(parameter.name for parameter in fields(cls) if parameter.name != "extra_fields")

    def items(self) -> Iterable[tuple[str, Tensor]]:
        """Return the names and tensors of the parameters, those of `extra_fields` last."""
        return [*((name, getattr(self, name)) for name in self.names()), *self.extra_fields.items()]

    def __len__(self) -> int:
        return len(self.means)

    @property
    def scales(self) -> Tensor:
        """(N, 3) standard deviations, world units."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> Tensor:
        """(N,) in [0, 1]."""
        return self.opacity_logits.sigmoid()

    @property
    def channels(self) -> int:
        return self.sh.shape[2]

    @property
    def sh_degree(self) -> int:
        return round(self.sh.shape[1] ** 0.5) - 1

    def activated(self, sh_degree: int) -> GaussianTensors:
        """Return the Gaussians after their activations, with the harmonics up to a degree."""
        return GaussianTensors(self.means, self.quats, self.scales, self.opacities, self.sh, sh_degree)

    def map(self, function: Callable[[Tensor], Tensor]) -> Gaussians:
        """Apply a function to every tensor."""
        parameters = {name: function(getattr(self, name)) for name in self.names()}
        extra = {name: function(tensor) for name, tensor in self.extra_fields.items()}
        return Gaussians(**parameters, extra_fields=extra)

    def select(self, index: Tensor | slice) -> Gaussians:
        """Return the Gaussians at an index, in a slice or under a mask."""
        return self.map(lambda tensor: tensor[index])

    def detach(self) -> Gaussians:
        """Return the Gaussians with detached tensors."""
        return self.map(torch.Tensor.detach)


@dataclass(frozen=True)
class RenderedFields:
    """A hook that renders chosen fields of Gaussians.

    The backend `cpu` then needs no gradients of all Gaussians: it renders one opacity and one or two colour sets, of up
    to six channels in all, as it does the usual ones.
    """

    colors: tuple[str, ...] = ("sh",)  # colour sets (N, K, C), whose channels follow each other
    opacity: str = "opacity_logits"  # (N,) or (N, 1)

    def __call__(self, gaussians: Gaussians, sh_degree: int) -> GaussianTensors:
        """Return the fields after their activations, with the harmonics up to a degree."""
        fields = dict(gaussians.items())
        opacities = fields[self.opacity].reshape(len(gaussians)).sigmoid()
        colors = torch.cat([fields[name] for name in self.colors], dim=2)
        return gaussians.activated(sh_degree)._replace(opacities=opacities, colors=colors)


def padded(columns: int) -> int:
    """Return the number of columns rounded up to whole cache lines, as of rows of gradients.

    >>> padded(COLORS_AT + 4), padded(COLORS_AT + 48)
    (16, 64)
    """
    return -(-columns // LINE) * LINE

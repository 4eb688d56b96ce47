"""Result of the backward pass of a training view: gradients of some Gaussians, and the visible Gaussians."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import NamedTuple

import torch
from torch import Tensor


class GradientStatistics(NamedTuple):
    """Sums of density control, to which the gradients of a view are added."""

    grad_sum: Tensor  # (N,): lengths of the gradients by image means, in units of half the image
    absolute_sum: Tensor  # (N,): the same of absolute gradients; (0,): not accumulated
    half_width: float  # of the image, px
    half_height: float


@dataclass
class Gradients:
    """Rows in spans (first, count) of arrays with more capacity; a Gaussian has at most one row."""

    spans: list[tuple[int, int]]
    index: Tensor  # (capacity,) int32: the Gaussian of each row
    values: Tensor  # (capacity, columns) as in `tdgbench.splats.columns`; trailing columns of zeros may be missing
    image: Tensor  # (capacity, 3 or 5): d loss / d image mean per px (2), radius in px; absolute gradients per px (2)
    projected_spans: list[tuple[int, int]]
    projected: Tensor  # (capacity,) int32: Gaussians that were projected
    radii: Tensor  # (capacity,) int32 px: their radii; 0 is not visible
    pairs: int = 0  # (tile, Gaussian) pairs of the view; 0 where a backend does not count them
    blended: int = 0  # pairs that the blend read before their tile ended
    lease: object = field(default=None, repr=False)  # keeps the memory of the arrays from being reused

    @property
    def columns(self) -> int:
        """Columns of a row."""
        return self.values.shape[1]

    @property
    def touched(self) -> int:
        """Number of rows: Gaussians with a gradient."""
        return sum(count for _, count in self.spans)

    def compute(self, image_only: bool = False) -> Gradients:
        """Return these gradients, as `PendingGradients.compute` does."""
        return self

    @classmethod
    def dense(cls, values: Tensor, image: Tensor, radii: Tensor, absgrad: Tensor | None = None) -> Gradients:
        """Return gradients of every Gaussian: values (N, columns), image means (N, 2) per px; radii (N,) px.

        absgrad: (N, 2) sums over pixels of the absolute gradients of the image means, per px.
        """
        everything = torch.arange(len(values), dtype=torch.int32, device=values.device)
        whole = [(0, len(values))]
        image = torch.cat([image, radii[:, None].to(image), *([] if absgrad is None else [absgrad])], dim=1)
        return cls(whole, everything, values, image, whole, everything, radii)

    @classmethod
    def total(cls, parts: list[Gradients], count: int) -> Gradients:
        """Sum of the gradients of several views, for `count` Gaussians."""
        if len(parts) == 1:
            return parts[0]
        like = parts[0].values
        values = like.new_zeros(count, max(part.values.shape[1] for part in parts))
        image = like.new_zeros(count, 2)
        radii = torch.zeros(count, dtype=torch.int32, device=like.device)
        for part in parts:
            index, rows, on_image = part.rows()
            values[:, : rows.shape[1]].index_add_(0, index, rows)
            image.index_add_(0, index, on_image[:, :2])
            radii = torch.maximum(radii, part.all_radii(count))
        return cls.dense(values, image, radii)

    def rows(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the index (n,), values (n, columns) and image (n, 3 or 5) of the rows in use."""
        parts = [slice(first, first + count) for first, count in self.spans]
        return tuple(torch.cat([t[part] for part in parts]) for t in (self.index, self.values, self.image))  # type: ignore[return-value]

    def all_radii(self, count: int) -> Tensor:
        """Return the radii of all `count` Gaussians, int32 (count,) px; 0 of invisible ones."""
        parts = [slice(first, first + number) for first, number in self.projected_spans]
        projected, radii = (torch.cat([t[part] for part in parts]) for t in (self.projected, self.radii))
        return radii.new_zeros(count).index_put_((projected,), radii)


class PendingGradients(ABC):
    """Gradients of a view that are not computed yet. Its fields are those of `Gradients`.

    They are used once: `compute` stores them, or the optimiser's step computes them and moves the Gaussians in one
    pass.
    """

    projected_spans: list[tuple[int, int]]
    projected: Tensor
    radii: Tensor
    pairs: int
    blended: int
    touched: int  # 0 until the step

    @abstractmethod
    def compute(self, image_only: bool = False) -> Gradients:
        """Compute the gradients as rows. image_only: those by image means alone; `values` has no columns."""

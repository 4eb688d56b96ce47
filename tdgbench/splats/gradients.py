"""Gradients of some of the Gaussians, and what a camera saw of all: what a backward pass leaves for a training step."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor


@dataclass
class Gradients:
    """Rows in pieces (first, count); the arrays may hold more, unused, between them."""

    pieces: list[tuple[int, int]]
    index: Tensor  # (room,) int32: the Gaussian of each row; a Gaussian occurs once
    values: Tensor  # (room, columns): as in `tdgbench.splats.columns`, perhaps without the last ones, which are zero
    image: Tensor  # (room, 3): d loss / d image mean per px, radius in px
    seen_pieces: list[tuple[int, int]]
    seen: Tensor  # (room,) int32: Gaussians that were projected
    radii: Tensor  # (room,) int32 px: their radii; 0 is out of sight
    pairs: int = 0  # (tile, Gaussian) pairs that the view listed; 0 where a backend does not tell
    blended: int = 0  # of them, those looked at before their tile had ended
    owner: object = field(default=None, repr=False)  # of memory that is used again once this is gone

    @classmethod
    def dense(cls, values: Tensor, image: Tensor, radii: Tensor) -> Gradients:
        """From a backend that gives gradients (N, columns) and (N, 2) to every Gaussian."""
        everything = torch.arange(len(values), dtype=torch.int32, device=values.device)
        whole = [(0, len(values))]
        image = torch.cat([image, radii[:, None].to(image)], dim=1)
        return cls(whole, everything, values, image, whole, everything, radii)

    @classmethod
    def total(cls, parts: list[Gradients], count: int) -> Gradients:
        """The sum of several views' gradients, for `count` Gaussians."""
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
            seen, own = part.visible()
            radii[seen] = torch.maximum(radii[seen], own)
        return cls.dense(values, image, radii)

    def rows(self) -> tuple[Tensor, Tensor, Tensor]:
        """index, values and image without the unused places."""
        parts = [slice(first, first + count) for first, count in self.pieces]
        return tuple(torch.cat([t[part] for part in parts]) for t in (self.index, self.values, self.image))  # type: ignore[return-value]

    def visible(self) -> tuple[Tensor, Tensor]:
        """Gaussians in sight and their radii."""
        parts = [slice(first, first + count) for first, count in self.seen_pieces]
        seen, radii = (torch.cat([t[part] for part in parts]) for t in (self.seen, self.radii))
        return seen[radii > 0], radii[radii > 0]

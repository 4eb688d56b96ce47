"""Result of the backward pass of a training view: gradients of some Gaussians, and the visible Gaussians."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import AdamStep, step_rows
from tdgbench.splats.cpu.raster.passes import Blended
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.statistics import NO_STATISTICS, GradientStatistics, observe_gradients

STEPS_EACH = 8192  # rows that are worth a thread


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

    def observe(self, statistics: GradientStatistics) -> None:
        """Add the image-plane gradients of float32 rows on the CPU to density control's statistics."""
        rows = (self.index.numpy(), self.image.numpy(), statistics)
        calls = [(*span, *rows) for span in self.spans]
        pool.run(observe_gradients, calls, items=self.touched, each=pool.ROWS_EACH)

    def take_step(self, step: AdamStep, statistics: GradientStatistics = NO_STATISTICS) -> np.ndarray:
        """Take a step of Adam with these float32 rows on the CPU, and `observe` them.

        Returns (spans, columns of the state) float32: 1 in columns with a gradient that is not finite.
        """
        if statistics.active:
            self.observe(statistics)
        spans = self.spans
        if len(spans) == 1:  # of a backend that does not split its rows
            first, count = spans[0]
            spans = [(first + a, b - a) for a, b in pool.chunks(count, pool.threads_for(count, STEPS_EACH))]
        bad = new_flags(len(spans), step)
        missing, values = step.rows.columns - self.columns, self.values
        if missing > 0:
            values = torch.nn.functional.pad(values, (0, missing))
        rows = (self.index.numpy(), values.numpy(), step)
        pool.run(step_rows, [(*span, *rows, flags) for span, flags in zip(spans, bad, strict=True)])
        return bad

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
        """Return the radii of all `count` Gaussians, int32 (count,) px; 0 of those that are not visible."""
        parts = [slice(first, first + number) for first, number in self.projected_spans]
        projected, radii = (torch.cat([t[part] for part in parts]) for t in (self.projected, self.radii))
        return radii.new_zeros(count).index_put_((projected,), radii)


class PendingGradients:
    """Gradients of a view that are not computed yet, with its visible Gaussians. Use `compute` or `take_step`, once.

    `take_step` computes the gradients and steps the Gaussians in one pass, without storing gradients.
    """

    def __init__(self, blended: Blended) -> None:
        done = blended.done
        self._blended = blended
        self.projected_spans = done.projected_spans
        self.columns = blended.columns
        self.pairs, self.blended = len(done.tiles.splat_ids), int(done.visits.counts.sum())
        self.touched = 0

    @cached_property
    def projected(self) -> Tensor:
        """(capacity,) int32: Gaussians that were projected."""
        return torch.from_numpy(self._blended.done.projected.gaussian_ids)

    @cached_property
    def radii(self) -> Tensor:
        """(capacity,) int32 px: their radii; 0 is not visible."""
        return torch.from_numpy(self._blended.done.projected.radii)

    def compute(self, image_only: bool = False) -> Gradients:
        """Compute the gradients as rows. image_only: without those of parameters, so that `values` has no columns."""
        rows = self._blended.rows(image_only)
        index, values, image = map(torch.from_numpy, rows.arrays)
        lease = (rows.workspace, self._blended.done.workspace)
        return Gradients(
            rows.spans, index, values, image, self.projected_spans, self.projected, self.radii, self.pairs,
            self.blended, lease,
        )  # fmt: skip

    def take_step(self, step: AdamStep, statistics: GradientStatistics) -> np.ndarray:
        """Take a step of Adam and add to density control's statistics, as `Gradients.take_step`, in one pass."""
        bad = new_flags(len(self._blended.done.splat_spans), step)
        self.touched = self._blended.step(step, statistics, bad)
        return bad


def new_flags(spans: int, step: AdamStep) -> np.ndarray:
    """Return (spans, columns of the state) float32 zeros, in which a step marks columns with bad gradients."""
    flags = empty_aligned((spans, step.rows.stride), np.float32)
    flags[:] = 0
    return flags

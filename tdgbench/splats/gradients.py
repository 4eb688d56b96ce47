"""Gradients of some Gaussians after the backward pass of a training view, and Adam's steps by them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.transfer import copy_like, start_copy_to_host

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15  # 3DGS

BadColumns = np.ndarray | Callable[[], np.ndarray] | None  # (..., columns), not 0 where a gradient is not finite


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
    values: Tensor  # (capacity, columns) as in `tdgbench.splats.gaussians`; trailing columns of zeros may be missing
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


class Rows(Protocol):
    """The properties of a `TrainingState` that a backend reads."""

    now: int
    channels: int

    @property
    def values(self) -> Tensor: ...

    @property
    def first(self) -> Tensor: ...

    @property
    def second(self) -> Tensor: ...

    def arrays(self) -> RowArrays: ...

    def columns_of(self, name: str) -> slice: ...

    def channels_of(self, name: str) -> int: ...

    def split(self, rows: Tensor) -> Gaussians: ...


class RowArrays(NamedTuple):
    """Rows of a `TrainingState`: its properties of the same names."""

    values: np.ndarray
    first: np.ndarray
    second: np.ndarray
    bounds: np.ndarray
    clocks: np.ndarray


class Tolerance(NamedTuple):
    """Upper bounds of how far deferred steps move a Gaussian away from the bounds that culling tests."""

    mean: float  # world units
    log_scale: float


class ColumnFactors(NamedTuple):
    """Constants of one step by column, float64 (columns,)."""

    rates: np.ndarray  # learning rates
    bias1: np.ndarray  # 1 − β1^t
    bias2: np.ndarray  # 1 − β2^t


class RowSteps:
    """Steps of every row at each step, in plain torch."""

    most_deferred = 0.0  # learning rates by which deferred steps can move a row
    longest_deferral = 0  # steps

    def __init__(self, state: Rows) -> None:
        self.state = state

    def take(
        self,
        gradients: Gradients | PendingGradients,
        factors: ColumnFactors,
        statistics: GradientStatistics | None = None,
    ) -> BadColumns:
        """Take step `state.now`; pending gradients are computed in the same pass, which adds to the statistics.

        Return the columns with a gradient that is not finite, or None. On a GPU, return a function that waits for the
        step and returns them.
        """
        assert statistics is None, "these steps observe nothing"
        columns = np.stack([factors.rates / factors.bias1, np.sqrt(factors.bias2)])
        return self._step_all(gradients.compute().values, copy_like(torch.from_numpy(columns), self.state.values))

    @torch.no_grad()
    def _step_all(self, grad: Tensor, columns: Tensor) -> BadColumns:
        """Step every row by its gradient (N, columns). columns: (2, columns), rate / (1 − β1^t) and √(1 − β2^t)."""
        (sizes, bias), (values, first, second) = columns, (self.state.values, self.state.first, self.state.second)
        first.lerp_(grad, 1 - BETA1)
        second.mul_(BETA2).addcmul_(grad, grad, value=1 - BETA2)
        values.sub_(sizes * first / (second.sqrt() / bias + EPS))
        if grad.device.type == "cpu" and torch.isfinite(grad.sum()):  # one pass in the usual case
            return None
        return flags_on_host((~torch.isfinite(grad)).any(dim=0))

    def flush(self) -> None:
        """Apply the deferred steps of every row."""

    def state_dict(self) -> dict[str, Any]:
        """Return what a checkpoint needs besides the rows, as `torch.save` takes it."""
        return {}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""


def flags_on_host(bad: Tensor) -> BadColumns:
    """Return flags (columns,) as an array; for flags on a GPU, a function that waits for them and returns it."""
    if bad.device.type == "cpu":
        return bad.numpy()
    flags = start_copy_to_host(bad)
    return lambda: flags().numpy()

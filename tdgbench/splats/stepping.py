"""Steps of Adam on the rows of a training: the interface of optimiser and backend, and the version in plain torch."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.gradients import Gradients, GradientStatistics, PendingGradients
from tdgbench.splats.transfer import copy_like, start_copy_to_host

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15  # 3DGS

BadColumns = np.ndarray | Callable[[], np.ndarray] | None  # (..., columns), not 0 where a gradient is not finite


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

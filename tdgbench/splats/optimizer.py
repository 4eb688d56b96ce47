"""Adam over Gaussians, with 3DGS's learning rates. The cost of a step depends on the rows that have a gradient."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt

from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.gradients import (
    BETA1,
    BETA2,
    ColumnFactors,
    Gradients,
    GradientStatistics,
    PendingGradients,
    Tolerance,
)
from tdgbench.splats.harmonics import sh_from_color
from tdgbench.splats.state import TrainingState

BLACK = sh_from_color(torch.tensor(0.001, dtype=torch.float64)).item()  # just not clamped by a render


@dataclass(frozen=True)
class LearningRates:
    """Learning rates of the parameters. That of the means falls log-linearly and is in units of the scene extent."""

    means_initial: PositiveFloat
    means_final: PositiveFloat
    means_steps: PositiveInt  # iterations
    sh_dc: NonNegativeFloat
    sh_rest: NonNegativeFloat
    opacity_logits: NonNegativeFloat
    log_scales: NonNegativeFloat
    quats: NonNegativeFloat

    def means(self, iteration: int) -> float:
        """Return the rate of the means at an iteration (1-based): log-linear until `means_steps`, then constant.

        >>> rates = LearningRates(1e-2, 1e-4, 50, sh_dc=0.0, sh_rest=0.0, opacity_logits=0.0, log_scales=0.0, quats=0.0)
        >>> [round(rates.means(iteration), 6) for iteration in (0, 25, 50, 500)]
        [0.01, 0.001, 0.0001, 0.0001]
        """
        return log_linear(self.means_initial, self.means_final, iteration / self.means_steps)


def log_linear(first: float, last: float, share: float) -> float:
    """Return the log-linear interpolation from `first` at a share of 0 to `last` at a share of 1 or more (3DGS).

    >>> round(log_linear(1e-2, 1e-4, 0.5), 6)
    0.001
    """
    t = min(max(share, 0.0), 1.0)
    return math.exp(math.log(first) * (1 - t) + math.log(last) * t)


class Adam:
    """torch.optim.Adam's update for one set of Gaussians.

    The backend of the state takes the steps, and may defer the steps of rows without gradient: call `flush` before
    reading `state.values`.
    """

    def __init__(
        self,
        state: TrainingState,
        rates: LearningRates,
        extent: float,
        learning_rates: Mapping[str, float | str] | None = None,
    ) -> None:
        """extent: of the scene, world units. learning_rates: rates by field, in the place of `rates`: a number (0
        freezes the field), or the name of the parameter whose rate the field shares.

        Raises ValueError for a field of `extra_fields` without a rate, and for the rate of an unknown field.
        """
        self.state, self.rates, self.extent, self.learning_rates = state, rates, extent, dict(learning_rates or {})
        self.slowdown = 1.0  # factor of all learning rates, at most 1
        names = [name for name, _ in state.split(state.values[:0]).items()]
        if not {*names[len(Gaussians.names()) :]} <= {*self.learning_rates} <= {*names}:
            raise ValueError(f"there are rates for {[*self.learning_rates]}; the fields are {', '.join(names)}")
        self.row_steps = state.backend.steps_of(state)
        self._places = {name: state.columns_of(name) for name in names}
        self._steps, self._rates = np.zeros((2, state.values.shape[1]))  # of each column; for steps see `steps`
        for name, columns in self._places.items():
            self._rates[columns] = self._rate_of(name, 0)
        self._of_means = [at for name, at in self._places.items() if self.learning_rates.get(name, name) == "means"]

    @property
    def steps(self) -> dict[str, int]:
        """Steps of each parameter so far; opacities take none in the iterations of their resets."""
        return {name: int(self._steps[columns.start]) for name, columns in self._places.items()}

    def step(
        self,
        gradients: Gradients | PendingGradients,
        iteration: int,
        without: Sequence[str] = (),
        statistics: GradientStatistics | None = None,
    ) -> Callable[[], str | None] | str | None:
        """Take one step at an iteration (1-based). The parameters `without` have no gradient and count no step.

        Pending gradients are computed in the same pass, which adds to `statistics`. Return the name of a parameter
        whose gradient is not finite, or None. On a GPU, return a function that waits for the step and returns the name.
        """
        state = self.state
        self._steps += 1
        for name in without:
            gradients = gradients.compute()
            gradients.values[:, state.columns_of(name)] = 0
            self._steps[self._places[name]] -= 1
        state.now += 1
        bad = self.row_steps.take(gradients, self._factors(iteration), statistics)
        return (lambda: self._first_marked(bad())) if callable(bad) else self._first_marked(bad)

    def _first_marked(self, bad: np.ndarray | None) -> str | None:
        """Return the name of the first parameter with a nonzero column in `bad` (…, columns)."""
        if bad is None:
            return None
        return next((name for name in self._places if bad[..., self.state.columns_of(name)].any()), None)

    def position_rate(self, iteration: int) -> float:
        """Return the learning rate of the means at an iteration, world units."""
        return self.slowdown * float(self._rate_of("means", iteration))

    def flush(self) -> None:
        """Apply the deferred steps of every row."""
        self.row_steps.flush()

    def tolerance(self, iteration: int) -> Tolerance:
        """Return the largest distance of rows from their culling bounds at an iteration."""
        first, rates = max(iteration - self.row_steps.longest_deferral, 0), self.row_steps.most_deferred
        return Tolerance(*(rates * float(self._rate_of(name, first)) for name in ("means", "log_scales")))

    @torch.no_grad()
    def lift_dark(self) -> None:
        """Set base colours below black to black. For SH degree 0, where the base colour is the whole colour.

        A render clamps darker colours to black (3DGS), so that they get no gradient and stay dark for ever.
        """
        for name, columns in self._places.items():
            if self.learning_rates.get(name, name) == "sh":
                base = slice(columns.start, columns.start + self.state.channels_of(name))
                self.state.values[:, base].clamp_min_(BLACK)

    def reset_moments(self, name: str) -> None:
        """Zero the moments of one parameter (3DGS, `replace_tensor_to_optimizer`); `flush` first."""
        columns = self.state.columns_of(name)
        self.state.first[:, columns] = 0
        self.state.second[:, columns] = 0

    def state_dict(self) -> dict[str, Any]:
        """Return the state besides the rows, as `torch.save` takes it."""
        return {"steps": self.steps, **self.row_steps.state_dict()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for name, columns in self._places.items():
            self._steps[columns] = saved["steps"][name]
        self.row_steps.load_state_dict(saved)

    def _factors(self, iteration: int) -> ColumnFactors:
        for columns in self._of_means:
            self._rates[columns] = self.rates.means(iteration) * self.extent
        steps = np.maximum(self._steps, 1)
        return ColumnFactors(self.slowdown * self._rates, 1 - BETA1**steps, 1 - BETA2**steps)

    def _rate_of(self, name: str, iteration: int) -> np.ndarray | float:
        """Return the learning rate of a field, or those of its columns. Only that of the means changes."""
        rate = self.learning_rates.get(name, name)
        if not isinstance(rate, str):
            return rate
        if rate == "sh":
            columns, channels = self.state.columns_of(name), self.state.channels_of(name)
            return np.where(np.arange(columns.stop - columns.start) < channels, self.rates.sh_dc, self.rates.sh_rest)
        return {
            "means": self.rates.means(iteration) * self.extent,
            "log_scales": self.rates.log_scales,
            "quats": self.rates.quats,
            "opacity_logits": self.rates.opacity_logits,
        }[rate]

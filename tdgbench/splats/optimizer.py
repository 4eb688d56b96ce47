"""Adam over Gaussians, with 3DGS's learning rates. The cost of a step depends on the rows that have a gradient."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from pydantic import NonNegativeFloat, PositiveFloat, PositiveInt

from tdgbench.splats.columns import LEAST_COLUMNS
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import AdamStep, Decay, Deferred, Rows, Stale, Update, flush_rows, sum_displacements
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.statistics import NO_STATISTICS, GradientStatistics
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.gradients import Gradients, PendingGradients
from tdgbench.splats.harmonics import sh_from_color
from tdgbench.splats.state import TrainingState
from tdgbench.splats.transfer import received, sent
from tdgbench.splats.warp import fuses

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15  # 3DGS
RHO = BETA1 / math.sqrt(BETA2)
FLUSH_EVERY = 128  # steps
# |m| / √v ≤ (1 − β1) / √(1 − β2) · √(Σ (β1² / β2)^j) by Cauchy and Schwarz: no step is longer than 7.3 rates.
MAX_SPEED = (1 - BETA1) / math.sqrt((1 - BETA2) * (1 - BETA1**2 / BETA2))
UPDATE_CONSTANTS = tuple(np.float32(c) for c in (1 - BETA1, 1 - BETA2, EPS))
MAX_DEFERRED = MAX_SPEED * RHO / (1 - RHO)  # rates by which deferred steps can move a row
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
    """Return what falls log-linearly from `first` at a share of 0 to `last` at 1, and stays there (3DGS).

    >>> round(log_linear(1e-2, 1e-4, 0.5), 6)
    0.001
    """
    t = min(max(share, 0.0), 1.0)
    return math.exp(math.log(first) * (1 - t) + math.log(last) * t)


class Tolerance(NamedTuple):
    """Upper bounds of how far deferred steps move a Gaussian away from the bounds that culling tests."""

    mean: float  # world units
    log_scale: float


class Adam:
    """torch.optim.Adam's update for one set of Gaussians.

    On the CPU in float32 the steps of rows without gradient are deferred (see `tdgbench.splats.cpu.adam`): call `flush`
    before reading `state.values`. Elsewhere every step moves every row.
    """

    def __init__(
        self,
        state: TrainingState,
        rates: LearningRates,
        extent: float,
        learning_rates: Mapping[str, float | str] | None = None,
    ) -> None:
        """extent: of the scene, world units. learning_rates: learning rates by field, which replace those of `rates`: a
        number (0 freezes the field), or the name of the parameter whose rate it has.

        Raises ValueError for a field of `extra_fields` without a rate, and for the rate of an unknown field.
        """
        self.state, self.rates, self.extent, self.learning_rates = state, rates, extent, dict(learning_rates or {})
        self.slowdown = 1.0  # factor of all learning rates, at most 1
        names = [name for name, _ in state.split(state.values[:0]).items()]
        if not {*names[len(Gaussians.names()) :]} <= {*self.learning_rates} <= {*names}:
            raise ValueError(f"there are rates for {[*self.learning_rates]}; the fields are {', '.join(names)}")
        self.is_sparse = state.values.device.type == "cpu" and state.values.dtype == torch.float32
        self._flushed = 0  # step of the last flush
        self._used = 0  # columns that ever had a gradient
        width = state.values.shape[1]
        self._places = {name: state.columns_of(name) for name in names}
        self._steps, self._rates = np.zeros((2, width))  # of each column; steps as torch counts them, see `steps`
        for name, columns in self._places.items():
            self._rates[columns] = self._rate_of(name, 0)
        self._of_means = [at for name, at in self._places.items() if self.learning_rates.get(name, name) == "means"]
        self._update_columns = empty_aligned((2, width), np.float32)
        self._coefficients = torch.zeros(FLUSH_EVERY, width).numpy()  # by step: rate √(1 − β2^t) / (1 − β1^t)
        self._displacements = torch.zeros((FLUSH_EVERY + 1) * width).numpy()
        exponents = np.arange(FLUSH_EVERY + 2, dtype=np.float64)
        self._decay = Decay(*((beta**exponents).astype(np.float32) for beta in (BETA1, BETA2)))
        self._rho_powers = (RHO**exponents).astype(np.float32)

    @property
    def steps(self) -> dict[str, int]:
        """Steps of each parameter so far: opacity misses those of its resets."""
        return {name: int(self._steps[columns.start]) for name, columns in self._places.items()}

    def step(
        self,
        gradients: Gradients | PendingGradients,
        iteration: int,
        without: Sequence[str] = (),
        statistics: GradientStatistics = NO_STATISTICS,
    ) -> Callable[[], str | None] | str | None:
        """Take one step at an iteration (1-based); for the parameters `without` it is as if their `.grad` were None.

        Pending gradients are computed in the same pass, which adds to `statistics`. Return the name of a parameter
        whose gradient is not finite, or None; of Gaussians on a GPU, what waits for the step and returns this.
        """
        state = self.state
        self._steps += 1
        for name in without:
            gradients = gradients.compute()
            gradients.values[:, state.columns_of(name)] = 0
            self._steps[self._places[name]] -= 1
        rates, bias1, bias2 = self._columns(iteration)
        state.now += 1
        if not self.is_sparse:
            return self._step_all(gradients.compute().values, rates / bias1, np.sqrt(bias2))
        columns = max(LEAST_COLUMNS, min(gradients.columns, state.values.shape[1]))
        self._used = max(self._used, columns)
        roots = np.sqrt(bias2)
        step_sizes, per_bias2 = self._update_columns
        np.divide(rates, bias1, out=step_sizes, casting="same_kind")
        np.divide(1, roots, out=per_bias2, casting="same_kind")
        self._coefficients[state.now % FLUSH_EVERY] = rates * roots / bias1
        update = Update(step_sizes, per_bias2, *UPDATE_CONSTANTS)
        step = AdamStep(self._rows(columns), self._deferred(state.now - 1), self._decay, update)
        bad = gradients.take_step(step, statistics)
        deferred = state.now - self._flushed
        sum_displacements(deferred, state.now, self._coefficients, np.float32(RHO), self._displacements)
        if deferred >= FLUSH_EVERY - 1:
            self.flush()
        return self._first_marked(bad) if bad.any() else None

    def _first_marked(self, bad: np.ndarray) -> str | None:
        """Return the name of the first parameter with a nonzero column in `bad` (…, columns)."""
        return next((name for name in self._places if bad[..., self.state.columns_of(name)].any()), None)

    def position_rate(self, iteration: int) -> float:
        """Return the learning rate of the means at an iteration, world units."""
        return self.slowdown * float(self._rate_of("means", iteration))

    def stale(self) -> Stale:
        """Return all rows with their deferred steps, which a kernel applies to a row before it reads the row."""
        return Stale(self._rows(self._used), self._deferred(self.state.now), self._flushed)

    def flush(self) -> None:
        """Apply the deferred steps of every row."""
        state = self.state
        if state.now == self._flushed:
            return
        if self.is_sparse:
            common = (self._rows(self._used), self._deferred(state.now), self._decay)
            pool.run(flush_rows, [(*part, *common) for part in pool.chunks(len(state), pool.get_threads())])
        self._flushed = state.now

    def tolerance(self, iteration: int) -> Tolerance:
        """Return the largest distance of rows from their culling bounds at an iteration."""
        means, log_scales = (self._rate_of(name, max(iteration - FLUSH_EVERY, 0)) for name in ("means", "log_scales"))
        return Tolerance(MAX_DEFERRED * float(means), MAX_DEFERRED * float(log_scales))

    @torch.no_grad()
    def lift_dark(self) -> None:
        """Set base colours below black to black; at SH degree 0 they are all of the colour.

        A render clamps them (3DGS), so that no gradient brings them back, whatever comes to lie there.
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
        return {
            "steps": self.steps,
            "flushed": self._flushed,
            "used": self._used,
            "coefficients": torch.from_numpy(self._coefficients),
            "displacements": torch.from_numpy(self._displacements),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for name, columns in self._places.items():
            self._steps[columns] = saved["steps"][name]
        self._flushed, self._used = saved["flushed"], saved["used"]
        self._coefficients[:] = saved["coefficients"].numpy()
        self._displacements[:] = saved["displacements"].numpy()

    def _rows(self, columns: int) -> Rows:
        """Return the state's memory, as the kernels take it."""
        values, first, second, bounds, clocks = self.state.arrays()
        flat = (values.reshape(-1), first.reshape(-1), second.reshape(-1))
        return Rows(*flat, bounds, clocks, values.shape[1], columns)

    def _deferred(self, last: int) -> Deferred:
        """Return constants of the deferred steps up to step `last`."""
        eps = np.float32(EPS * math.sqrt(1 - BETA2 ** max(self.state.now, 1)))
        return Deferred(last, self._displacements, self._rho_powers, eps)

    def _columns(self, iteration: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return learning rate, 1 − β1^t and 1 − β2^t of each column: float64 (columns,)."""
        for columns in self._of_means:
            self._rates[columns] = self.rates.means(iteration) * self.extent
        steps = np.maximum(self._steps, 1)
        return self.slowdown * self._rates, 1 - BETA1**steps, 1 - BETA2**steps

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

    @torch.no_grad()
    def _step_all(
        self, grad: torch.Tensor, step_sizes: np.ndarray, bias2_sqrt: np.ndarray
    ) -> Callable[[], str | None] | str | None:
        """Step every row by its gradient (N, columns); return what `step` does."""
        values, first, second = rows = (self.state.values, self.state.first, self.state.second)
        columns = sent(torch.from_numpy(np.stack([step_sizes, bias2_sqrt])), values)
        if fuses(values):
            from tdgbench.splats.warp.adam import step_all

            bad = step_all(grad, columns, rows, (BETA1, BETA2), EPS)
        else:
            sizes, bias = columns
            first.lerp_(grad, 1 - BETA1)
            second.mul_(BETA2).addcmul_(grad, grad, value=1 - BETA2)
            values.sub_(sizes * first / (second.sqrt() / bias + EPS))
            if grad.device.type == "cpu" and torch.isfinite(grad.sum()):  # one pass in the usual case
                return None
            bad = (~torch.isfinite(grad)).any(dim=0)
        if bad.device.type == "cpu":
            return self._first_marked(bad.numpy())
        flags = received(bad)
        return lambda: self._first_marked(flags().numpy())

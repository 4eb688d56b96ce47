"""Adam over Gaussians, with 3DGS's learning rates. A step costs what it touches, and is the same as a step for all."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import coast_candidates, settle_rows, touched_rows, write_drift
from tdgbench.splats.gaussians import Gaussians
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.state import TrainingState

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15  # 3DGS
RHO = BETA1 / math.sqrt(BETA2)
SETTLE_EVERY = 128  # steps after which every row is brought up to date
# |m| / √v is at most (1 − β1) / √(1 − β2) · √(Σ (β1² / β2)^j) by Cauchy and Schwarz: no step is longer than 7.3 rates.
MAX_SPEED = (1 - BETA1) / math.sqrt((1 - BETA2) * (1 - BETA1**2 / BETA2))
MAX_COAST = MAX_SPEED * RHO / (1 - RHO)  # rates that a row can move while it is not touched


@dataclass(frozen=True)
class LearningRates:
    """Learning rates; that of the means falls log-linearly and is in units of the scene extent."""

    position_initial: float
    position_final: float
    position_steps: int
    sh_dc: float
    sh_rest: float
    opacity: float
    log_scale: float
    quaternion: float

    def position(self, iteration: int) -> float:
        """Rate of the means at an iteration (1-based): log-linear until `position_steps`, then constant."""
        t = min(max(iteration / self.position_steps, 0.0), 1.0)
        return math.exp(math.log(self.position_initial) * (1 - t) + math.log(self.position_final) * t)


class Adam:
    """torch.optim.Adam's update for one set of Gaussians.

    On the CPU in float32 rows without gradient are left where they are until someone looks at them (see
    `tdgbench.splats.cpu.adam`): `settle` before reading `state.values`. Elsewhere every row moves at every step.
    """

    def __init__(self, state: TrainingState, rates: LearningRates, extent: float) -> None:
        self.state, self.rates, self.extent = state, rates, extent
        self.steps = dict.fromkeys(Gaussians.names(), 0)  # as torch counts them: opacity misses those of its resets
        self.is_sparse = state.values.device.type == "cpu" and state.values.dtype == torch.float32
        self._settled = 0
        self._used = 0  # columns that ever had a gradient
        width = state.values.shape[1]
        self._coefficients = torch.zeros(SETTLE_EVERY, width).numpy()  # by step: rate √(1 − β2^t) / (1 − β1^t)
        self._drift = torch.zeros((SETTLE_EVERY + 1) * width).numpy()
        exponents = np.arange(SETTLE_EVERY + 2, dtype=np.float64)
        self._powers = tuple((beta**exponents).astype(np.float32) for beta in (BETA1, BETA2))
        self._rho_powers = (RHO**exponents).astype(np.float32)

    def step(self, gradients: Gradients, iteration: int, without: str | None = None) -> str | None:
        """Take one step at an iteration (1-based); the parameter named `without` rests, as torch's without gradient.

        Returns the name of a parameter whose gradient is not finite, None if all are.
        """
        state = self.state
        if without is not None:
            gradients.values[:, state.column_of(without)] = 0
        for name in self.steps:
            self.steps[name] += name != without
        rates, bias1, bias2 = self._columns(iteration)
        state.now += 1
        if not self.is_sparse:
            self._step_all(gradients.values, rates / bias1, np.sqrt(bias2))
            finite = bool(torch.isfinite(gradients.values.sum()))
            return None if finite else self._name_of_bad(gradients.values)
        self._used = max(self._used, gradients.values.shape[1])
        step_sizes, per_bias2 = torch.zeros(2, len(rates))
        step_sizes[:], per_bias2[:] = torch.from_numpy(rates / bias1), torch.from_numpy(1 / np.sqrt(bias2))
        self._coefficients[state.now % SETTLE_EVERY] = rates * np.sqrt(bias2) / bias1
        constants = (*self._coasting(), *self._powers, step_sizes.numpy(), per_bias2.numpy())
        small = tuple(np.float32(c) for c in (1 - BETA1, 1 - BETA2, EPS))
        arrays = (gradients.index.numpy(), gradients.values.numpy(), *self._arrays())
        fine = pool.run(touched_rows, [(*p, *arrays, state.now, *constants, *small) for p in _cut(gradients.pieces)])
        behind = state.now - self._settled
        rho = np.float32(RHO)
        write_drift(behind, state.now, len(rates), self._coefficients, rho, self._drift)
        if behind >= SETTLE_EVERY - 1:
            self.settle()
        return None if all(fine) else self._name_of_bad(gradients.rows()[1])

    def _name_of_bad(self, rows: torch.Tensor) -> str | None:
        """The first parameter with a gradient that is not finite."""
        bad = (~torch.isfinite(rows)).any(dim=0)
        return next((name for name in self.steps if bool(bad[self.state.column_of(name)].any())), None)

    def catch_up(self, spans: list[tuple[int, int]], candidates: np.ndarray) -> None:
        """Bring the parameters of candidates[first : first + count] up to date, for every span."""
        if self.state.now == self._settled:
            return
        stride, values, first, second, _, clocks = self._arrays()
        arrays = (candidates, self._used, stride, values, first, second, clocks)
        pool.run(coast_candidates, [(*s, *arrays, self.state.now, *self._coasting()) for s in _cut(spans)])

    def settle(self) -> None:
        """Bring every row up to date."""
        state = self.state
        if state.now == self._settled:
            return
        if self.is_sparse:
            arrays = (self._used, *self._arrays(), state.now, *self._coasting(), *self._powers)
            pieces = pool.chunks(len(state), pool.get_threads())
            pool.run(settle_rows, [(*piece, *arrays) for piece in pieces])
        self._settled = state.now

    def slack(self, iteration: int) -> tuple[float, float]:
        """How far a row can be from its bounds: of the mean in world units, of the logarithm of a deviation."""
        fastest = self.rates.position(max(iteration - SETTLE_EVERY, 0)) * self.extent
        return MAX_COAST * fastest, MAX_COAST * self.rates.log_scale

    def forget(self, name: str) -> None:
        """Zero the moments of one parameter (3DGS, `replace_tensor_to_optimizer`); all rows must be current."""
        columns = self.state.column_of(name)
        self.state.first[:, columns] = 0
        self.state.second[:, columns] = 0

    def state_dict(self) -> dict[str, Any]:
        """What a step depends on beside the rows, as `torch.save` takes it."""
        return {
            "steps": dict(self.steps),
            "settled": self._settled,
            "used": self._used,
            "coefficients": torch.from_numpy(self._coefficients),
            "drift": torch.from_numpy(self._drift),
        }

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Take over what `state_dict` gave."""
        self.steps = dict(saved["steps"])
        self._settled, self._used = saved["settled"], saved["used"]
        self._coefficients[:] = saved["coefficients"].numpy()
        self._drift[:] = saved["drift"].numpy()

    def _arrays(self):
        """stride, then flat parameters and moments, bounds and clocks, as the kernels take them."""
        state = self.state
        flat = (t.numpy().reshape(-1) for t in (state.values, state.first, state.second))
        return (state.values.shape[1], *flat, state.bounds.numpy(), state.clocks.numpy())

    def _coasting(self) -> tuple[np.ndarray, np.ndarray, np.float32]:
        """How rows move while they are not touched: drift, powers of ρ, and eps beside a √v without bias correction."""
        still = np.float32(EPS * math.sqrt(1 - BETA2 ** max(self.state.now, 1)))
        return self._drift, self._rho_powers, still

    def _columns(self, iteration: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Learning rate, 1 − β1^t and 1 − β2^t of each column."""
        width = self.state.values.shape[1]
        rates, steps = np.zeros(width), np.ones(width)
        by_name = {
            "means": self.rates.position(iteration) * self.extent,
            "log_scales": self.rates.log_scale,
            "quats": self.rates.quaternion,
            "opacity_logits": self.rates.opacity,
            "sh": self.rates.sh_rest,
        }
        for name, rate in by_name.items():
            columns = self.state.column_of(name)
            rates[columns], steps[columns] = rate, max(self.steps[name], 1)
        start = self.state.column_of("sh").start
        rates[start : start + self.state.channels] = self.rates.sh_dc
        return rates, 1 - BETA1**steps, 1 - BETA2**steps

    @torch.no_grad()
    def _step_all(self, grad: torch.Tensor, step_sizes: np.ndarray, bias2_sqrt: np.ndarray) -> None:
        values, first, second = self.state.values, self.state.first, self.state.second
        sizes, bias = (torch.as_tensor(a, dtype=values.dtype, device=values.device) for a in (step_sizes, bias2_sqrt))
        first.lerp_(grad, 1 - BETA1)
        second.mul_(BETA2).addcmul_(grad, grad, value=1 - BETA2)
        values.sub_(sizes * first / (second.sqrt() / bias + EPS))


def _cut(pieces: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """As many pieces (first, count) as there are threads, if there is only one."""
    if len(pieces) > 1:
        return pieces
    return [(pieces[0][0] + a, b - a) for a, b in pool.chunks(pieces[0][1], pool.get_threads())]

"""Rows of parameters, of which a step moves one: those of a thermal camera, a row for each view or one for all."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

BETA1, BETA2, EPS = 0.9, 0.99, 1e-15  # of Adam; a view is seen rarely, so that 3DGS's β2 would forget too slowly


class LearnedRows:
    """R rows of parameters of any shape, with Adam's moments and numbers of steps, float64."""

    def __init__(self, start: np.ndarray) -> None:
        """start: (R, ...)."""
        self.values = np.array(start, np.float64)
        self._first, self._second = np.zeros((2, *self.values.shape))
        self.steps = np.zeros(len(self.values), np.int64)

    def step(self, row: int, gradient: np.ndarray, rates: np.ndarray | float, decay: float) -> None:
        """Adam's step of a row by its gradient, with a rate or those of its parameters; decay towards 0 as in AdamW."""
        self.steps[row] += 1
        count = int(self.steps[row])
        values, first, second = self.values[row], self._first[row], self._second[row]
        first += (1 - BETA1) * (gradient - first)
        second += (1 - BETA2) * (gradient**2 - second)
        size = np.sqrt(second / (1 - BETA2**count)) + EPS
        values *= 1 - decay * rates
        values -= rates * first / (1 - BETA1**count) / size

    def state_dict(self) -> dict[str, Any]:
        """Everything that steps change, as `torch.save` takes it."""
        arrays = {"values": self.values, "first": self._first, "second": self._second, "steps": self.steps}
        return {name: torch.from_numpy(array) for name, array in arrays.items()}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""
        for mine, name in ((self.values, "values"), (self._first, "first"), (self._second, "second")):
            mine[:] = saved[name].numpy()
        self.steps[:] = saved["steps"].numpy()

"""Adam for networks and tables of radiance fields."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tdgbench.fields.kernels import step_entries
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.simd.registers import LANES

ENTRIES_EACH = 262_144  # worth a thread


class FieldAdam(torch.optim.Optimizer):
    """Adam (Kingma and Ba 2015) that leaves out entries whose gradient is exactly 0 (Müller et al. 2022, §4).

    They keep value and moments, where torch's Adam moves them on. So a step reads no more of a large table than what
    its samples reached.
    """

    def __init__(
        self, parameters: Iterable[Tensor], lr: float, betas: tuple[float, float] = (0.9, 0.999), eps: float = 1e-15
    ) -> None:
        """eps: that of Müller et al.; entries of tables have small gradients."""
        super().__init__(parameters, {"lr": lr, "betas": betas, "eps": eps})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Make a step; parameters without gradients stay as they are."""
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._step(parameter, parameter.grad, group)

    def _step(self, parameter: Tensor, gradient: Tensor, group: dict[str, Any]) -> None:
        state, (beta1, beta2) = self.state[parameter], group["betas"]
        if not state:
            state |= {"step": 0, "first": torch.zeros_like(parameter), "second": torch.zeros_like(parameter)}
        state["step"] += 1
        step_size = group["lr"] / (1 - beta1 ** state["step"])
        per_bias2 = (1 - beta2 ** state["step"]) ** -0.5
        constants = beta1, 1 - beta1, beta2, 1 - beta2, step_size, per_bias2, group["eps"]
        flat = [one.view(-1) for one in (parameter, gradient.contiguous(), state["first"], state["second"])]
        whole = 0
        if parameter.device.type == "cpu" and parameter.dtype == torch.float32:
            whole = len(flat[0]) // LANES * LANES
            arrays = [tensor.numpy() for tensor in flat]
            shares = pool.chunks(whole // LANES, pool.threads_for(whole, ENTRIES_EACH))
            rounded = tuple(map(np.float32, constants))
            pool.run(step_entries, [(start * LANES, stop * LANES, *arrays, rounded) for start, stop in shares])
        if whole < len(flat[0]):
            step_in_torch([tensor[whole:] for tensor in flat], constants)


def step_in_torch(tensors: list[Tensor], constants: tuple[float, ...]) -> None:
    """Do what `step_entries` does with values, gradients and moments, in plain torch."""
    (values, gradient, first, second), (beta1, rest1, beta2, rest2, step_size, per_bias2, eps) = tensors, constants
    changes = gradient != 0
    first.copy_(torch.where(changes, beta1 * first + rest1 * gradient, first))
    second.copy_(torch.where(changes, beta2 * second + rest2 * gradient.square(), second))
    values.sub_(torch.where(changes, step_size * first / (second.sqrt() * per_bias2 + eps), 0.0))

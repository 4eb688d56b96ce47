"""Adam over Gaussians, with 3DGS's learning rates, and moments that follow when Gaussians come and go."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch

from tdgbench.splats.cpu.adam import adam_step
from tdgbench.splats.gaussians import Gaussians, concatenate

BETA1, BETA2, EPS = 0.9, 0.999, 1e-15  # 3DGS


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
    """torch.optim.Adam's update for one set of Gaussians (a parameter without gradient is left alone)."""

    def __init__(self, gaussians: Gaussians, rates: LearningRates, extent: float) -> None:
        self.rates = rates
        self.extent = extent
        self.first = gaussians.detach().zeros_like()
        self.second = gaussians.detach().zeros_like()
        self.steps = dict.fromkeys(Gaussians.names(), 0)

    def step(self, gaussians: Gaussians, iteration: int) -> None:
        """Move every parameter that has a gradient, then drop the gradients."""
        for name, parameter in gaussians.items():
            if parameter.grad is None:
                continue
            self.steps[name] += 1
            rates = self._column_rates(name, parameter, iteration)
            _update(
                parameter,
                parameter.grad,
                getattr(self.first, name),
                getattr(self.second, name),
                rates,
                self.steps[name],
            )
            parameter.grad = None

    def _column_rates(self, name: str, parameter: torch.Tensor, iteration: int) -> np.ndarray:
        """The learning rate of each column of a parameter seen as (N, columns)."""
        columns = parameter[0].numel() if len(parameter) else 1
        if name == "sh":
            rates = np.full(columns, self.rates.sh_rest)
            rates[: parameter.shape[2]] = self.rates.sh_dc
            return rates
        scalar = {
            "means": self.rates.position(iteration) * self.extent,
            "log_scales": self.rates.log_scale,
            "quats": self.rates.quaternion,
            "opacity_logits": self.rates.opacity,
        }[name]
        return np.full(columns, scalar)

    def keep(self, index: torch.Tensor) -> None:
        """Follow a selection of Gaussians."""
        self.first, self.second = self.first.select(index), self.second.select(index)

    def append(self, added: Gaussians) -> None:
        """New Gaussians begin with zero moments; step counts go on (3DGS, `cat_tensors_to_optimizer`)."""
        self.first = concatenate([self.first, added.zeros_like()])
        self.second = concatenate([self.second, added.zeros_like()])

    def forget(self, name: str) -> None:
        """Zero the moments of one parameter (3DGS, `replace_tensor_to_optimizer`)."""
        getattr(self.first, name).zero_()
        getattr(self.second, name).zero_()


@torch.no_grad()
def _update(parameter, grad, first, second, rates: np.ndarray, step: int) -> None:
    """One Adam step in place: the fused kernel for float32 on the CPU, torch elsewhere."""
    step_sizes = rates / (1 - BETA1**step)
    bias2_sqrt = math.sqrt(1 - BETA2**step)
    if parameter.device.type == "cpu" and parameter.dtype == torch.float32:
        arrays = [
            t.detach().view(len(t), -1 if len(t) else 1).numpy() for t in (parameter, grad.contiguous(), first, second)
        ]
        adam_step(arrays, step_sizes.astype(np.float32), BETA1, BETA2, bias2_sqrt, EPS)
        return
    first.lerp_(grad, 1 - BETA1)
    second.mul_(BETA2).addcmul_(grad, grad, value=1 - BETA2)
    sizes = torch.as_tensor(step_sizes, dtype=parameter.dtype, device=parameter.device)
    sizes = sizes.view((1, *parameter.shape[1:]) if parameter.dim() > 1 else (1,))
    parameter.sub_(sizes * first / (second.sqrt() / bias2_sqrt + EPS))

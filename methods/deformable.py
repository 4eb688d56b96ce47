"""What methods after Deformable 3D Gaussians (Yang et al. 2024) share: a network over Gaussians, and its rate."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial

import torch
from torch import Tensor
from torch.nn import functional as F

from tdgbench.splats.optimizer import log_linear

ADAM = partial(torch.optim.Adam, eps=1e-15)
FREQUENCIES = 10


class Trunk(torch.nn.Module):
    """Layers with ReLU, of which the one after the middle also gets the input (`utils/time_utils.py`)."""

    def __init__(self, inputs: int, width: int = 256, layers: int = 8) -> None:
        super().__init__()
        self.skip = layers // 2
        sizes = [inputs, *(width + inputs * (i == self.skip) for i in range(layers - 1))]
        self.layers = torch.nn.ModuleList(torch.nn.Linear(size, width) for size in sizes)

    def hidden(self, inputs: Tensor) -> Tensor:
        """Return the last layer's values (N, width) of inputs (N, columns)."""
        hidden = inputs
        for i, layer in enumerate(self.layers):
            hidden = F.relu(layer(hidden))
            if i == self.skip:
                hidden = torch.cat([inputs, hidden], dim=1)
        return hidden


def seconds_of(network: Callable[[Tensor], Tensor], parameters: Iterable[Tensor], means: Tensor) -> float:
    """Return the measured time of a network's values and gradients at means (N, 3)."""
    few = means[:2000].detach()
    start = time.perf_counter()
    torch.autograd.grad(network(few).sum(), list(parameters), allow_unused=True)
    return (time.perf_counter() - start) * len(means) / max(len(few), 1)


def encoded_size(columns: int) -> int:
    """Return the columns of `encoded` values."""
    return columns * (1 + 2 * FREQUENCIES)


def encoded(values: Tensor) -> Tensor:
    """Return values (N, columns) beside their sines and cosines at ten octaves from frequency 1 on (NeRF, no π)."""
    bands = [2.0**k for k in range(FREQUENCIES)]
    waves = [wave(values * band) for band in bands for wave in (torch.sin, torch.cos)]
    return torch.cat([values, *waves], dim=1)


def falling(rates: list[float], steps: int) -> Callable[[int], float]:
    """Return the learning rate by iteration (1-based): from first to last, log-linearly, changing after each step."""
    return lambda iteration: log_linear(rates[0], rates[1], (iteration - 1) / steps)

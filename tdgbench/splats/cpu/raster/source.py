"""Input of the kernels: Gaussians as rows (`tdgbench.splats.columns`), and the bounds that culling tests."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from tdgbench.splats.cpu.adam import NO_STALE, Stale
from tdgbench.splats.cpu.scratch import empty_rows

Span = tuple[int, int]  # first, count
BOUNDS = 4  # floats of a row's bounds: mean and largest log scale


class Parameters(NamedTuple):
    """Rows of N Gaussians, `stride` floats each."""

    values: np.ndarray  # (N · stride,) float32; a cache line beyond may be read
    stride: int
    raw: bool  # before activation: scales are natural logarithms, opacities are logits


class Bounds(NamedTuple):
    """Bounds that culling tests: mean and largest deviation. The true ones may exceed them by a tolerance."""

    values: np.ndarray  # (N · BOUNDS,) float32: mean, and largest standard deviation, world units, or its logarithm
    raw: bool  # whether it is the natural logarithm
    tolerance: np.float32  # world units between a true mean and that of `values`
    growth: np.float32  # by how much the logarithm of a true deviation may exceed that of `values`


@dataclass(frozen=True)
class GaussianSource:
    """N Gaussians to render."""

    count: int
    parameters: Parameters
    bounds: Bounds
    stale: Stale = NO_STALE  # deferred steps, applied to candidates before their parameters are read


def source_of_arrays(arrays: Sequence[np.ndarray]) -> GaussianSource:
    """Return the source of means (N, 3), quats (N, 4), scales (N, 3), opacities (N,) and colors (N, …), activated."""
    parts = [torch.from_numpy(array).reshape(len(array), math.prod(array.shape[1:])) for array in arrays]
    values = empty_rows(len(parts[0]), sum(part.shape[1] for part in parts))
    torch.cat(parts, dim=1, out=torch.from_numpy(values))  # NumPy takes twice as long
    largest = functools.reduce(np.maximum, arrays[2].T)
    bounds = np.concatenate([arrays[0], largest[:, None]], axis=1)
    return source_of_rows(values, bounds, 0.0, 0.0, raw=False)


def source_of_rows(
    values: np.ndarray, bounds: np.ndarray, tolerance: float, growth: float, stale: Stale = NO_STALE, raw: bool = True
) -> GaussianSource:
    """Return the source of rows (N, columns), by default before activation.

    values: a cache line beyond them may be read, see `empty_rows`. bounds (N, 4): mean and largest scale (raw: its
    logarithm), each as of the last update of the bounds.
    """
    tested = Bounds(bounds.reshape(-1), raw, np.float32(tolerance), np.float32(growth))
    return GaussianSource(len(values), Parameters(values.reshape(-1), values.shape[1], raw), tested, stale)

"""Where the kernels find Gaussians: flat float32 memory, with a stride and a first column for each parameter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.adam import NO_STALE, Stale

Span = tuple[int, int]  # first, count
BOUNDS = 4  # floats of a row's bounds: mean and largest log scale


class Columns(NamedTuple):
    """One parameter of N Gaussians: that of Gaussian i begins at values[i · stride + first]."""

    values: np.ndarray  # (any,) float32
    stride: int
    first: int


class Parameters(NamedTuple):
    """The five parameters of N Gaussians."""

    means: Columns  # 3 world coordinates
    quats: Columns  # 4, wxyz, any length
    scales: Columns  # 3 standard deviations in world units
    opacities: Columns  # 1
    colors: Columns  # one per channel, or K coefficients × channels
    raw: bool  # before activation: scales are natural logarithms, opacities are logits


class Bounds(NamedTuple):
    """What culling tests: means and deviations, which the true ones may exceed by a tolerance."""

    means: Columns  # 3 world coordinates
    scales: Columns  # `axes` standard deviations in world units, or their natural logarithms if raw
    axes: int  # 1 (the largest) or 3
    raw: bool  # rows of BOUNDS floats
    tolerance: np.float32  # world units between a true mean and that of `means`
    growth: np.float32  # by how much the logarithm of a true deviation may exceed that of `scales`


@dataclass(frozen=True)
class GaussianSource:
    """N Gaussians to render."""

    count: int
    parameters: Parameters
    bounds: Bounds
    stale: Stale = NO_STALE  # what is due to candidates before their parameters are read


def source_of_arrays(arrays: Sequence[np.ndarray]) -> GaussianSource:
    """Return means (N, 3), quats (N, 4), scales (N, 3), opacities (N,) and colors (N, …) as a source: C-contiguous."""
    columns = [Columns(a.reshape(-1), int(np.prod(a.shape[1:])), 0) for a in arrays]
    means, scales = columns[0], columns[2]
    return GaussianSource(len(arrays[0]), Parameters(*columns, False), Bounds(means, scales, 3, False, _ZERO, _ZERO))


def source_of_rows(
    values: np.ndarray, bounds: np.ndarray, tolerance: float, growth: float, stale: Stale = NO_STALE
) -> GaussianSource:
    """Return the source of rows (N, columns) as in `tdgbench.splats.columns`, before activation.

    bounds (N, 4): mean and largest log scale, each as of the last update of the bounds.
    """
    flat, stride, flat_bounds = values.reshape(-1), values.shape[1], bounds.reshape(-1)
    columns = [Columns(flat, stride, first) for first in (MEANS_AT, QUATS_AT, SCALES_AT, OPACITY_AT, COLORS_AT)]
    means, scales = Columns(flat_bounds, BOUNDS, 0), Columns(flat_bounds, BOUNDS, 3)
    tested = Bounds(means, scales, 1, True, np.float32(tolerance), np.float32(growth))
    return GaussianSource(len(values), Parameters(*columns, True), tested, stale)


_ZERO = np.float32(0)

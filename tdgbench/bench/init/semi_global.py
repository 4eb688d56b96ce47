"""Semi-global matching (Hirschmüller 2008): depths of a view that neighbouring pixels share where texture is weak."""

from __future__ import annotations

import numpy as np


def aggregated(cost: np.ndarray, slant: float, jump: float) -> np.ndarray:
    """Return matching costs (planes, H, W) as means over the eight straight paths to each pixel (eq. 13).

    slant: penalty of neighbours on a path that are one plane apart. jump: of those further apart.

    >>> cost = np.ones((4, 1, 3))
    >>> cost[1, 0, [0, 2]] = 0  # the pixel in the middle has no texture
    >>> aggregated(cost, 0.4, 2.0).argmin(axis=0).tolist()
    [[1, 1, 1]]
    """
    total = np.zeros_like(cost)
    for way in (1, -1):
        for shift in (-1, 0, 1):
            total[:, ::way] += _down(cost[:, ::way], shift, slant, jump)
        total.swapaxes(1, 2)[:, ::way] += _down(cost.swapaxes(1, 2)[:, ::way], 0, slant, jump)
    return total / 8


def _down(cost: np.ndarray, shift: int, slant: float, jump: float) -> np.ndarray:
    """Return path costs (planes, H, W) from the first row on; the column before x is x − shift."""
    path = cost.copy()
    for row in range(1, cost.shape[1]):
        before = np.zeros_like(cost[:, 0])
        inside = slice(max(shift, 0), before.shape[1] + min(shift, 0))
        before[:, inside] = np.roll(path[:, row - 1], shift, axis=1)[:, inside]
        least = before.min(axis=0)
        beside = np.pad(before, ((1, 1), (0, 0)), constant_values=np.inf)
        beside = np.minimum(beside[:-2], beside[2:]) + slant
        path[:, row] += np.minimum(np.minimum(before, beside), least + jump) - least
    return path

"""Where the parameters of a Gaussian stand in a row of numbers: the layout that training and its gradients share."""

from __future__ import annotations

MEANS_AT, SCALES_AT, QUATS_AT, OPACITY_AT, COLORS_AT = 0, 3, 6, 10, 11
ALIGNMENT = 16  # floats: rows begin and end on cache lines


def padded(columns: int) -> int:
    """A number of columns rounded up to whole cache lines."""
    return -(-columns // ALIGNMENT) * ALIGNMENT

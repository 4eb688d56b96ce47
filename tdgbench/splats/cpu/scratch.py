"""Working memory that is used again: fresh pages cost a fault each, some milliseconds per render.

A lease is a set of arrays taken together; they go back when the lease is garbage collected, so an autograd graph may
hold them as long as it lives.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

KEEP = 3  # buffers of one role that wait for their next use
HEADROOM = 1.25
ALIGNMENT = 64

_free: dict[str, list[np.ndarray]] = defaultdict(list)


def empty_aligned(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """An uninitialised array that begins on a cache line; NumPy asks for huge pages where the system has them."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return _aligned_part(np.empty(size + ALIGNMENT, np.uint8), size).view(dtype).reshape(shape)


def _aligned_part(buffer: np.ndarray, size: int) -> np.ndarray:
    start = -buffer.ctypes.data % ALIGNMENT
    return buffer[start : start + size]


def release() -> None:
    """Give back what waits for its next use."""
    _free.clear()


class Lease:
    """Arrays by role, uninitialised, 64-byte aligned."""

    def __init__(self) -> None:
        self._taken: list[tuple[str, np.ndarray]] = []

    def take(self, role: str, shape: int | tuple[int, ...], dtype: type) -> np.ndarray:
        """An array of that shape; what is in it is left over from before."""
        size = int(np.prod(shape)) * np.dtype(dtype).itemsize
        waiting = _free[role]
        buffer = waiting.pop() if waiting else None
        if buffer is None or len(buffer) < size + ALIGNMENT:
            buffer = np.empty(int(size * HEADROOM) + ALIGNMENT, np.uint8)
        self._taken.append((role, buffer))
        return _aligned_part(buffer, size).view(dtype).reshape(shape)

    def __del__(self) -> None:
        for role, buffer in self._taken:
            if len(_free[role]) < KEEP:
                _free[role].append(buffer)

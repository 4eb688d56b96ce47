"""Workspace: uninitialised arrays that later renders reuse. Page faults of new memory cost milliseconds per render.

A lease is a set of arrays taken together. They return to the pool when the lease is garbage collected, so an autograd
graph can hold them.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

KEEP = 3  # unused buffers of one role
HEADROOM = 1.25
ALIGNMENT = 64

_free: dict[str, list[np.ndarray]] = defaultdict(list)


def empty_aligned(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """An uninitialised array that starts on a cache line; NumPy requests huge pages where the system has them."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    return _aligned_part(np.empty(size + ALIGNMENT, np.uint8), size).view(dtype).reshape(shape)


def _aligned_part(buffer: np.ndarray, size: int) -> np.ndarray:
    start = -buffer.ctypes.data % ALIGNMENT
    return buffer[start : start + size]


def release() -> None:
    """Free all unused buffers."""
    _free.clear()


class Lease:
    """Arrays by role, uninitialised, 64-byte aligned."""

    def __init__(self) -> None:
        self._taken: list[tuple[str, np.ndarray]] = []

    def take(self, role: str, shape: int | tuple[int, ...], dtype: type) -> np.ndarray:
        """An uninitialised array of a shape."""
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

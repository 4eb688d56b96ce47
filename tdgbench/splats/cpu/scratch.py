"""Scratch memory that is reused: fresh pages cost a fault each, some milliseconds per render.

A workspace holds arrays that are taken together. They become free when it is garbage collected, so an autograd graph
may hold them for as long as it lives.
"""

from __future__ import annotations

import ctypes
import math
import os
from collections import defaultdict

import numpy as np

MAX_FREE = 3  # free buffers of one role that are kept
HEADROOM = 1.25
ALIGNMENT = 64  # bytes

_free: dict[str, list[np.ndarray]] = defaultdict(list)


def empty_aligned(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Return an uninitialised array that begins on a cache line; NumPy asks for huge pages where the system has them.

    >>> empty_aligned((3, 5), np.float32).ctypes.data % ALIGNMENT
    0
    """
    return np.ndarray(shape, dtype, _aligned_bytes(math.prod(shape) * np.dtype(dtype).itemsize))


def empty_rows(count: int, columns: int, zeros: bool = False) -> np.ndarray:
    """Return rows (count, columns) float32, from a cache line on, that may be read a line beyond their end.

    Uninitialised, or zeros: those that are never written take no memory, if they are many.
    """
    return np.ndarray((count, columns), np.float32, _aligned_bytes(4 * count * columns + ALIGNMENT, zeros))


def _aligned_bytes(size: int, zeros: bool = False) -> np.ndarray:
    buffer = (np.zeros if zeros else np.empty)(size + ALIGNMENT, np.uint8)
    start = -buffer.ctypes.data % ALIGNMENT
    return buffer[start : start + size]


def free_buffers() -> None:
    """Free the memory of all free buffers, and give back what C's allocator holds of memory that was freed."""
    _free.clear()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:  # glibc
        trim(ctypes.c_size_t(0))


class Workspace:
    """Arrays by role, uninitialised, 64-byte aligned."""

    def __init__(self) -> None:
        self._taken: list[tuple[str, np.ndarray]] = []

    def take(self, role: str, shape: int | tuple[int, ...], dtype: type) -> np.ndarray:
        """Return an array of a shape, with arbitrary contents."""
        count = shape if isinstance(shape, int) else math.prod(shape)
        size = count * np.dtype(dtype).itemsize
        waiting = _free[role]
        buffer = waiting.pop() if waiting else None
        if buffer is None or len(buffer) < size:
            buffer = _aligned_bytes(int(size * HEADROOM))
        self._taken.append((role, buffer))
        return np.ndarray(shape, dtype, buffer)

    def __del__(self) -> None:
        for role, buffer in self._taken:
            if len(_free[role]) < MAX_FREE:
                _free[role].append(buffer)

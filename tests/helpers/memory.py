"""Memory that a call takes."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tdgbench.bench.machine import PeakMemory


def peak_mb(call: Callable[[], object]) -> float:
    """By how many MB a call raises the size of this process, at its largest."""
    with PeakMemory() as memory:
        before = memory.mb
        call()
    if before is None or memory.mb is None:
        pytest.skip("this platform does not tell the peak of a process's memory")
    return memory.mb - before

"""Interleaved timing: candidates take turns, so that a slow moment of the machine affects all of them."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import TypeVar

import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import reductions
from tdgbench.splats.cpu.simd import registers as simd

Key = TypeVar("Key")
FMA_CHAINS, FMA_STEPS = 16, 1_000_000


def interleave(candidates: Mapping[Key, Callable[[], float]], repetitions: int) -> dict[Key, list[float]]:
    """Seconds of each candidate: call all once to warm up, then in turns; a candidate returns its seconds.

    >>> interleave({"a": lambda: 1.0, "b": lambda: 2.0}, repetitions=2)
    {'a': [1.0, 1.0], 'b': [2.0, 2.0]}
    """
    for run in candidates.values():
        run()
    seconds: dict[Key, list[float]] = {name: [] for name in candidates}
    for _ in range(repetitions):
        for name, run in candidates.items():
            seconds[name].append(run())
    return seconds


def median_ms(seconds: list[float]) -> float:
    """Median of some seconds, in milliseconds.

    >>> median_ms([0.5, 0.25, 3.0])
    500.0
    """
    return 1e3 * statistics.median(seconds)


@kernel()
def _fma_chains(steps, out):
    """Run sixteen independent chains, which hide the latency of two FMA units."""
    x = simd.broadcast(np.float32(0.999999))
    c = simd.broadcast(np.float32(1e-7))
    a0, a1, a2, a3, a4, a5, a6, a7 = c, c, c, c, c, c, c, c
    b0, b1, b2, b3, b4, b5, b6, b7 = c, c, c, c, c, c, c, c
    for _ in range(steps):
        a0 = a0 * x + c
        a1 = a1 * x + c
        a2 = a2 * x + c
        a3 = a3 * x + c
        a4 = a4 * x + c
        a5 = a5 * x + c
        a6 = a6 * x + c
        a7 = a7 * x + c
        b0 = b0 * x + c
        b1 = b1 * x + c
        b2 = b2 * x + c
        b3 = b3 * x + c
        b4 = b4 * x + c
        b5 = b5 * x + c
        b6 = b6 * x + c
        b7 = b7 * x + c
    total = a0 + a1 + a2 + a3 + (a4 + a5 + a6 + a7) + (b0 + b1 + b2 + b3) + (b4 + b5 + b6 + b7)
    out[0] = reductions.lane_sum(total)


def fma_peak_gflops() -> float:
    """Peak rate of fused multiply-adds on registers, all threads together, in GFLOP/s (two flops each)."""
    threads = pool.get_threads()
    outs = [np.zeros(1, np.float32) for _ in range(threads)]
    work = [(FMA_STEPS, out) for out in outs]
    pool.run(_fma_chains, work)
    best = min(_seconds(lambda: pool.run(_fma_chains, work)) for _ in range(7))
    return 2 * FMA_CHAINS * simd.LANES * FMA_STEPS * threads / best / 1e9


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start

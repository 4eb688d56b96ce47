"""Interleaved timing: candidates take turns, so that a slow moment of the machine affects all of them."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from typing import Literal, TypeVar, get_args

import torch

from benchmarks.common.clouds import leaves_of, view_of
from tdgbench.bench.backend_check.compare import Cloud

Key = TypeVar("Key")
Part = Literal["both", "forward", "backward"]
PARTS: tuple[Part, ...] = get_args(Part)


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


def time_pass(cloud: Cloud, part: Part, depth: bool = True) -> Callable[[], float]:
    """A function that renders a cloud as `rasterization` does, with all gradients; it returns seconds."""
    leaves = leaves_of(cloud)
    size = (cloud.height, cloud.width)
    grads = [torch.ones(*size, cloud.colors.shape[1]), *([torch.ones(size)] if depth else [])]

    def run() -> float:
        start = time.perf_counter()
        view = view_of(cloud, leaves, depth)
        middle = time.perf_counter()
        if part != "forward":
            torch.autograd.backward([view.image, view.requested_depth] if depth else [view.image], grads)
        end = time.perf_counter()
        for leaf in leaves:
            leaf.grad = None
        return {"forward": middle - start, "backward": end - middle, "both": end - start}[part]

    return run

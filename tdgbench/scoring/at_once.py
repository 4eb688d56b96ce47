"""Score several views in parallel, one thread each, so that scores do not depend on the number of threads."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import torch

from tdgbench.splats.cpu import pool

PIXELS_AT_ONCE = 8 * 640 * 480  # LPIPS with vgg takes up to 1 kB a pixel: 300 MB for a view of 640×480, 2.4 GB for 8

T = TypeVar("T")
R = TypeVar("R")


def map_views(function: Callable[[T], R], views: Sequence[T], pixels: int) -> list[R]:
    """Apply a function to views in parallel and return the results in their order.

    pixels: of the largest view; it limits the views in memory. torch uses one thread per view. An exception of the
    function is raised.
    """
    in_memory = max(1, PIXELS_AT_ONCE // max(1, pixels))
    workers = max(1, min(in_memory, pool.get_threads(), len(views)))
    with one_torch_thread(), ThreadPoolExecutor(workers, initializer=torch.set_num_threads, initargs=(1,)) as executor:
        return list(executor.map(function, views))


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Return a context in which torch computes on the calling thread alone."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)

"""Several views at once: order, number of threads, errors, memory."""

import threading

import numpy as np
import pytest
import torch

from tdgbench.scoring.scorer import PIXELS_AT_ONCE, map_views, one_torch_thread
from tdgbench.splats.cpu import pool


@pytest.fixture(autouse=True)
def torch_has_its_threads_again():
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_are_in_the_order_of_the_views(threads):
    pool.set_threads(threads)
    assert map_views(lambda view: view * view, range(23), pixels=1) == [n * n for n in range(23)]
    assert map_views(lambda view: view, [], pixels=0) == []


def test_views_are_worked_on_at_once_with_one_torch_thread_each():
    pool.set_threads(3)
    torch.set_num_threads(2)
    together = threading.Barrier(3, timeout=20)

    def work(view):
        together.wait()  # breaks unless three threads are here
        return torch.get_num_threads()

    assert map_views(work, range(3), pixels=1) == [1, 1, 1]
    assert torch.get_num_threads() == 2


def test_memory_bounds_the_views_at_once():
    pool.set_threads(8)
    busy, most, lock = [0], [0], threading.Lock()

    def work(view):
        with lock:
            busy[0] += 1
            most[0] = max(most[0], busy[0])
        np.ones(200_000).sum()
        with lock:
            busy[0] -= 1

    map_views(work, range(40), pixels=PIXELS_AT_ONCE // 2)
    assert most[0] <= 2


def test_an_error_of_a_view_is_raised():
    pool.set_threads(2)

    def work(view):
        if view == 3:
            raise ValueError("view 3")

    with pytest.raises(ValueError, match="view 3"):
        map_views(work, range(6), pixels=1)


def test_torch_has_its_threads_back_after_an_error():
    torch.set_num_threads(2)
    with pytest.raises(KeyError), one_torch_thread():
        assert torch.get_num_threads() == 1
        raise KeyError
    assert torch.get_num_threads() == 2

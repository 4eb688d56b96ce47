import threading

import pytest

from tdgbench.splats.cpu import pool


def test_results_come_in_order():
    assert pool.run(lambda a, b: a + b, [(i, 10 * i) for i in range(7)]) == [11 * i for i in range(7)]


def test_work_runs_at_the_same_time():
    barrier = threading.Barrier(3, timeout=10)
    pool.run(lambda i: barrier.wait(), [(i,) for i in range(3)])


def test_an_error_reaches_the_caller():
    def fail(i):
        if i == 2:
            raise RuntimeError("two")

    with pytest.raises(RuntimeError, match="two"):
        pool.run(fail, [(i,) for i in range(4)])


def test_chunks_cover_everything_once():
    for count in (0, 1, 5, 100):
        pieces = pool.chunks(count, 3)
        assert [i for a, b in pieces for i in range(a, b)] == list(range(count))


def test_threads_must_be_positive():
    with pytest.raises(ValueError, match="threads is 0"):
        pool.set_threads(0)

import math
import os
import random
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.pool import threads_for  # before tests have all work shared
from tdgbench.splats.cpu.simd import memory


def test_little_work_wakes_no_thread(monkeypatch):
    monkeypatch.setattr(pool, "_threads", 4)
    assert [threads_for(items, each=100) for items in (0, 199, 250, 300, 10_000)] == [1, 1, 2, 3, 4]
    monkeypatch.setattr(pool, "threads_for", threads_for)
    called = []
    assert pool.run(lambda i: called.append(threading.get_ident()) or i, [(1,), (2,)], items=150, each=100) == [1, 2]
    assert set(called) == {threading.get_ident()}


def test_work_runs_at_the_same_time():
    barrier = threading.Barrier(3, timeout=10)
    pool.run(lambda i: barrier.wait(), [(i,) for i in range(3)])


def test_an_error_reaches_the_caller():
    def fail(i):
        if i == 2:
            raise RuntimeError("two")

    with pytest.raises(RuntimeError, match="two"):
        pool.run(fail, [(i,) for i in range(4)])


def test_after_an_error_nothing_runs_on():
    ended = []

    def slow(i):
        if i == 0:
            raise RuntimeError("the first")
        time.sleep(0.05)
        ended.append(i)

    with pytest.raises(RuntimeError, match="the first"):
        pool.run(slow, [(i,) for i in range(3)])
    assert sorted(ended) == [1, 2]


def test_many_threads_may_ask_at_once():
    def ask(i):
        return [pool.run(lambda a: a * a, [(a,) for a in range(i, i + 3)]) for _ in range(50)]

    with ThreadPoolExecutor(4) as callers:
        for i, results in enumerate(callers.map(ask, range(4))):
            assert results == [[a * a for a in range(i, i + 3)]] * 50


class Alarm(KeyboardInterrupt):
    pass


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="this system has no interval timers")
def test_a_signal_at_any_moment_leaves_the_workers_usable():
    """`concurrent.futures` hangs here, or raises errors of its own."""

    def alarm(number, frame):
        raise Alarm

    moment, before = random.Random(0), signal.signal(signal.SIGALRM, alarm)
    try:
        for _ in range(2000):
            with pytest.raises(Alarm):
                signal.setitimer(signal.ITIMER_REAL, moment.uniform(1e-4, 6e-4))
                while True:
                    pool.run(abs, [(-1,), (-2,)])
            assert pool.run(abs, [(-3,), (-4,)]) == [3, 4]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_process_has_workers_of_its_own():
    pool.run(len, [("a",), ("b",)])
    child = os.fork()
    if child == 0:
        os._exit(0 if pool.run(len, [("a",), ("bb",)]) == [1, 2] else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_threads_must_be_positive():
    with pytest.raises(ValueError, match="threads is 0"):
        pool.set_threads(0)


@kernel()
def take(counter, out):
    for i in range(out.shape[0]):
        out[i] = memory.take_next(counter)


def test_work_is_handed_out_once():
    counter = np.zeros(1, np.int64)
    taken = [np.zeros(10_000, np.int64) for _ in range(3)]
    pool.run(take, [(counter, out) for out in taken])
    assert np.array_equal(np.sort(np.concatenate(taken)), np.arange(30_000))


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, math.inf), ({"cpu.max": "max 100000\n"}, math.inf), ({"cpu.max": "250000 100000\n"}, 2.5),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, math.inf),
        ({"cpu/cpu.cfs_quota_us": "50000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 0.5), ({"cpu.max": "?"}, math.inf),
    ],
)  # fmt: skip
def test_a_container_has_the_cores_of_its_quota(tmp_path, monkeypatch, files, cores):
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(content)
    assert pool.quota(tmp_path) == cores
    monkeypatch.setattr(pool, "quota", lambda: cores)
    monkeypatch.setattr(pool.os, "sched_getaffinity", lambda _: range(64), raising=False)
    assert pool.available_cores.__wrapped__() == {0.5: 1, 2.5: 3}.get(cores, 64)

import time

import pytest

from tdgbench.bench import memory
from tdgbench.bench.memory import SAMPLE_SECONDS, PeakMemory

MEGABYTES = 200


def grow_and_shrink() -> None:
    block = bytearray(MEGABYTES * 1024 * 1024)
    block[::4096] = b"x" * len(block[::4096])
    time.sleep(5 * SAMPLE_SECONDS)


def test_sees_a_peak_and_not_the_one_before():
    grow_and_shrink()
    with PeakMemory() as quiet:
        pass
    if quiet.mb is None:
        pytest.skip("this platform does not tell the memory of a process")
    with PeakMemory() as busy:
        grow_and_shrink()
    assert busy.mb > quiet.mb + 0.8 * MEGABYTES


def test_says_nothing_where_the_platform_does_not(monkeypatch, tmp_path):
    monkeypatch.setattr(memory, "STATUS", tmp_path / "nothing")
    with PeakMemory() as peak:
        pass
    assert peak.mb is None

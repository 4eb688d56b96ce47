"""GPUs are locked, cell by cell; peaks of memory are those of a cell. (`test_lock` kills the holder of a lock.)"""

import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
import torch

from tdgbench.bench import machine
from tdgbench.bench.machine import PeakMemory, exclusive_gpu
from tdgbench.splats.cpu import scratch
from tdgbench.splats.cpu.scratch import Workspace
from tests.helpers.paths import ROOT


def test_every_cell_gets_another_gpu(tmp_path):
    with exclusive_gpu(["a", "b"], tmp_path) as first, exclusive_gpu(["a", "b"], tmp_path) as second:
        assert (first, second) == (0, 1)
    with exclusive_gpu(["b"], tmp_path) as again:
        assert again == 0


def test_a_cell_waits_for_a_free_gpu(tmp_path):
    got = []

    def wait():
        with exclusive_gpu(["a"], tmp_path) as index:
            got.append(index)

    with exclusive_gpu(["a"], tmp_path):
        thread = threading.Thread(target=wait)
        thread.start()
        time.sleep(0.7)
        assert got == []
    thread.join(timeout=10)
    assert got == [0]


MEGABYTES = 200
SCRIPT = f"""
import json, time
from tdgbench.bench.machine import SAMPLE_SECONDS, PeakMemory

def grow_and_shrink():
    block = bytearray({MEGABYTES} * 1024 * 1024)
    block[::4096] = b"x" * len(block[::4096])
    time.sleep(5 * SAMPLE_SECONDS)

grow_and_shrink()
with PeakMemory() as quiet:
    pass
with PeakMemory() as busy:
    grow_and_shrink()
print(json.dumps([quiet.mb, busy.mb]))
"""


def test_measures_a_peak_and_not_the_one_before():
    run = subprocess.run([sys.executable, "-c", SCRIPT], cwd=ROOT, capture_output=True, text=True, check=True)
    quiet, busy = json.loads(run.stdout)
    if quiet is None:
        pytest.skip("this platform does not report the memory of a process")
    assert busy > quiet + 0.8 * MEGABYTES


def test_scratch_memory_of_the_cell_before_is_given_back():
    Workspace().take("test", MEGABYTES * 2**20, np.uint8)[:] = 1
    with PeakMemory() as second:
        left = sum(len(buffers) for buffers in scratch._free.values())
    assert left == 0
    if second.mb is not None:
        Workspace().take("test", MEGABYTES * 2**20, np.uint8)[:] = 1
        assert machine._read("VmRSS") > second.mb + 0.8 * MEGABYTES


def test_the_gpu_is_asked_only_for_work_on_it(monkeypatch):
    """A cell on the CPU opens no context on a GPU that others use."""
    asked = []
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "reset_peak_memory_stats", lambda: asked.append("reset"))
    monkeypatch.setattr(torch.cuda, "max_memory_reserved", lambda: asked.append("read") or 3 * 2**20)
    with PeakMemory() as peak:
        pass
    assert peak.gpu_mb is None and not asked
    with PeakMemory(on_gpu=True) as peak:
        assert asked == ["reset"]
    assert peak.gpu_mb == 3.0 and asked == ["reset", "read"]

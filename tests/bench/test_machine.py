import signal
import subprocess
import sys
import threading
import time

import pytest
import torch

from tdgbench.bench.machine import describe_gpu, exclusive_gpu, visible_gpus
from tests.helpers.paths import ROOT

HOLD = """
import sys, time
from pathlib import Path
from tdgbench.bench.machine import exclusive_gpu
with exclusive_gpu(["a", "b"], Path(sys.argv[1])) as index:
    print(index, flush=True)
    time.sleep(60)
"""


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


def test_a_killed_process_releases_its_gpu(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline().strip() == "0"
    with exclusive_gpu(["a", "b"], tmp_path) as index:
        assert index == 1
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with exclusive_gpu(["a"], tmp_path) as index:
        assert index == 0


def test_an_error_releases_the_gpu(tmp_path):
    with pytest.raises(RuntimeError), exclusive_gpu(["a"], tmp_path):
        raise RuntimeError
    with exclusive_gpu(["a"], tmp_path) as index:
        assert index == 0


def test_description():
    assert (describe_gpu() is None) == (not torch.cuda.is_available())
    assert len(visible_gpus()) == torch.cuda.device_count()
    if torch.cuda.is_available():
        assert describe_gpu()["driver"] and describe_gpu()["memory_mb"] > 500

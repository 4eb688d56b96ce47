import signal
import subprocess
import sys
import threading
import time

import pytest
import torch

from tdgbench.bench.gpu import a_gpu_of_its_own, describe_gpu, visible_gpus
from tests.conftest import ROOT

HOLD = """
import sys, time
from pathlib import Path
from tdgbench.bench.gpu import a_gpu_of_its_own
with a_gpu_of_its_own(["a", "b"], Path(sys.argv[1])) as index:
    print(index, flush=True)
    time.sleep(60)
"""


def test_every_cell_gets_another(tmp_path):
    with a_gpu_of_its_own(["a", "b"], tmp_path) as first, a_gpu_of_its_own(["a", "b"], tmp_path) as second:
        assert (first, second) == (0, 1)
    with a_gpu_of_its_own(["b"], tmp_path) as again:
        assert again == 0


def test_who_comes_late_waits(tmp_path):
    got = []

    def late():
        with a_gpu_of_its_own(["a"], tmp_path) as index:
            got.append(index)

    with a_gpu_of_its_own(["a"], tmp_path):
        thread = threading.Thread(target=late)
        thread.start()
        time.sleep(0.7)
        assert got == []
    thread.join(timeout=10)
    assert got == [0]


def test_a_killed_process_lets_go(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline().strip() == "0"
    with a_gpu_of_its_own(["a", "b"], tmp_path) as index:
        assert index == 1
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    with a_gpu_of_its_own(["a"], tmp_path) as index:
        assert index == 0


def test_an_error_inside_lets_go(tmp_path):
    with pytest.raises(RuntimeError), a_gpu_of_its_own(["a"], tmp_path):
        raise RuntimeError
    with a_gpu_of_its_own(["a"], tmp_path) as index:
        assert index == 0


def test_what_is_said_of_it():
    assert (describe_gpu() is None) == (not torch.cuda.is_available())
    assert len(visible_gpus()) == torch.cuda.device_count()
    if torch.cuda.is_available():
        assert describe_gpu()["driver"] and describe_gpu()["memory_mb"] > 500

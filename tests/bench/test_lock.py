import signal
import subprocess
import sys
import time

from tdgbench.bench.lock import cell_lock
from tests.helpers.paths import ROOT

HOLD = """
import sys, time
from pathlib import Path
from tdgbench.bench.lock import cell_lock
with cell_lock(Path(sys.argv[1]), Path(sys.argv[1]) / "cells" / "a") as acquired:
    print(acquired, flush=True)
    time.sleep(60)
"""


def test_one_at_a_time(tmp_path):
    a, b = tmp_path / "cells" / "a", tmp_path / "cells" / "b"
    with cell_lock(tmp_path, a) as first, cell_lock(tmp_path, a) as second, cell_lock(tmp_path, b) as other:
        assert (first, second, other) == (True, False, True)
    with cell_lock(tmp_path, a) as again:
        assert again


def test_a_killed_process_releases_its_lock(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert holder.stdout.readline().strip() == "True"
    with cell_lock(tmp_path, tmp_path / "cells" / "a") as acquired:
        assert not acquired
    holder.send_signal(signal.SIGKILL)
    holder.wait()
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        with cell_lock(tmp_path, tmp_path / "cells" / "a") as acquired:
            if acquired:
                return
        time.sleep(0.05)
    raise AssertionError("the lock of a killed process is still held")

"""Processes with a time limit end with everything that they started."""

import sys
from pathlib import Path

import pytest

from tdgbench.children import run_limited
from tests.helpers.waiting import waited

STARTS = "import subprocess, sys; print(subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(99)']).pid)"


@pytest.mark.parametrize("end", ["", "; import os; os.abort()"], ids=["exits", "crashes"])
def test_nothing_that_it_started_lives_on(tmp_path, end):
    ended = run_limited([sys.executable, "-u", "-c", STARTS + end], 60, tmp_path)
    assert (ended.status == 0) == (end == "")
    stat = Path(f"/proc/{int(ended.out)}/stat")
    waited(lambda: not stat.exists() or stat.read_text().rpartition(")")[2].split()[0] == "Z", 10, "the end of a child")

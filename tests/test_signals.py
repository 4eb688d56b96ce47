"""Ctrl-C and SIGTERM end a run in one line that says what is kept; its locks are free, and it can go on."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from filelock import FileLock

from tdgbench.children import with_path
from tests.helpers.configs import QUICK
from tests.helpers.paths import ROOT
from tests.helpers.waiting import waited

LONG = (*QUICK, "budget.iterations=1000000", "budget.plateau=null", "checkpoint=0.2", "method=3dgs", "scene=turntable")


def started(tmp_path: Path, *words: str) -> subprocess.Popen[str]:
    """A run in a new session, as a shell starts it."""
    environment = {**with_path(ROOT), "TORCH_HOME": str(tmp_path / "torch")}
    return subprocess.Popen(
        [sys.executable, "-m", "tdgbench", *words], cwd=tmp_path, env=environment, text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def end_session(run: subprocess.Popen[str]) -> None:
    """Kill a run and its workers, which would train on without it."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(run.pid, signal.SIGKILL)
    run.wait()


def wait_for_checkpoint(run: subprocess.Popen[str], folder: Path) -> None:
    checkpoints = folder / "checkpoints"
    waited(lambda: list(checkpoints.glob("[!.]*.pt")) or run.poll() is not None, 60, "a checkpoint is written")


def wait_for_handler(run: subprocess.Popen[str], number: signal.Signals) -> None:
    """Wait until a run takes a signal itself; the interpreter alone needs a second on a busy machine."""
    status = Path(f"/proc/{run.pid}/status")
    if not status.exists():
        pytest.skip("this platform does not tell which signals a process takes")

    def is_caught() -> int:
        line = next(one for one in status.read_text(encoding="utf-8").splitlines() if one.startswith("SigCgt:"))
        return int(line.split()[1], 16) >> (number - 1) & 1

    waited(is_caught, 60, f"a handler of {number.name} is there")


def test_a_signal_ends_a_run_in_one_line(tmp_path, data_root):
    run = started(tmp_path, *LONG, f"data.root={data_root}")
    try:
        wait_for_checkpoint(run, tmp_path / "results" / "single")
        run.send_signal(signal.SIGTERM)
        out, err = run.communicate(timeout=60)
    finally:
        end_session(run)
    assert run.returncode == 143 and out == ""
    lines = err.splitlines()
    kept = "results/single keeps 0 finished cells and a checkpoint of "
    assert len(lines) == 2 and ": starts, " in lines[0]
    assert lines[1].startswith(f"interrupted by SIGTERM; {kept}")
    with FileLock(next((tmp_path / "results" / "single" / "locks").glob("*.lock")), timeout=0):
        pass


def test_a_signal_during_the_start(tmp_path):
    run = started(tmp_path, *LONG)
    wait_for_handler(run, signal.SIGTERM)
    run.send_signal(signal.SIGTERM)
    _, err = run.communicate(timeout=60)
    assert run.returncode == 143 and err.startswith("interrupted by SIGTERM") and len(err.splitlines()) == 1


@pytest.mark.slow
def test_a_signal_ends_the_workers_of_a_sweep(tmp_path, data_root):
    joblib = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1")
    run = started(tmp_path, "-m", *LONG, f"data.root={data_root}", *joblib)
    try:
        wait_for_checkpoint(run, tmp_path / "results" / "single")
        run.send_signal(signal.SIGINT)
        _, err = run.communicate(timeout=60)
    finally:
        end_session(run)
    *before, last = err.splitlines()
    assert run.returncode == 130 and last.startswith("interrupted by SIGINT")
    assert all(": starts, " in line or " cells, " in line for line in before), err
    waited(lambda: not _of_session(run.pid), 20, "the workers end")


@pytest.mark.slow
def test_workers_end_with_a_sweep_that_is_killed(tmp_path, data_root):
    joblib = ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", "seed=0,1")
    run = started(tmp_path, "-m", *LONG, f"data.root={data_root}", *joblib)
    try:
        wait_for_checkpoint(run, tmp_path / "results" / "single")
        run.kill()
        waited(lambda: not _of_session(run.pid), 20, "the workers end")
    finally:
        end_session(run)


WATCHES = """
import os, subprocess, sys, time
watching = "import os, signal, time; from tdgbench import signals; signals.WATCH_SECONDS = 0.05; " \\
    "signals.watch(os.getppid(), lambda: os.killpg(0, signal.SIGKILL)); print(1, flush=True); time.sleep(60)"
child = subprocess.Popen([sys.executable, "-c", watching], start_new_session=True, stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(60)
"""


def test_a_process_that_watches_ends_with_the_one_that_started_it():
    parent = subprocess.Popen([sys.executable, "-c", WATCHES], cwd=ROOT, text=True, stdout=subprocess.PIPE)
    session = int(parent.stdout.readline())
    assert _of_session(session)
    parent.kill()
    parent.wait()
    waited(lambda: not _of_session(session), 20, "the watching process ends")


def _of_session(session: int) -> list[str]:
    """Processes of a session that still run."""
    listed = subprocess.run(["ps", "-eo", "sid=,stat=,args="], capture_output=True, text=True).stdout.splitlines()
    return [line for line in listed if line.split()[0] == str(session) and not line.split()[1].startswith("Z")]


def test_a_signal_after_the_work_changes_no_status():
    """The interpreter takes a moment to shut down; nothing is left to interrupt then."""
    at_exit = "import atexit, os, signal, sys; atexit.register(os.kill, os.getpid(), signal.SIGTERM); "
    code = f"{at_exit}sys.argv = ['tdgbench', '--version']; from tdgbench.__main__ import run; run()"
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")


SWALLOWED = """
import os, signal, time
from tdgbench import signals
signals.REPEAT_SECONDS = 0.2
class Ends:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.01)
with signals.interruptible() as interruption:
    interruption.begin()
    try:
        Ends()
        time.sleep(30)
    except signals.Interrupted:
        print("interrupted", interruption.status)
"""


TWICE = """
import os, signal, time
from tdgbench import signals
with signals.interruptible() as interruption:
    interruption.begin()
    for _ in range(2):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(30)
        except signals.Interrupted:
            print("clears up", flush=True)
"""


@pytest.mark.skipif(os.name == "nt", reason="there are no such signals")
def test_a_second_signal_ends_it_at_once():
    run = subprocess.run([sys.executable, "-c", TWICE], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (run.returncode, run.stdout, run.stderr) == (-signal.SIGTERM, "clears up\n", "")


@pytest.mark.skipif(os.name == "nt", reason="there is no timer that sends signals")
def test_a_signal_that_a_destructor_swallows_is_raised_again_and_nothing_else_printed():
    run = subprocess.run([sys.executable, "-c", SWALLOWED], cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert (run.stdout, run.stderr) == ("interrupted 143\n", "")

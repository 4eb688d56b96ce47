"""A check in a process of its own. Stand-ins for the child: one hangs, one crashes, one says yes."""

import contextlib
import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from tdgbench.bench.backend_check import check as checking
from tdgbench.bench.backend_check.check import BackendCheck, check_in_new_process
from tdgbench.splats.backends import ON_GPU
from tests.helpers.backends import need


def of(code: str, limit: float = 60.0) -> BackendCheck:
    return check_in_new_process("warp", 0, [sys.executable, "-c", code], limit)


HANGS = """
import subprocess, sys
compiler = subprocess.Popen(["sleep", "600"])
open(sys.argv[1], "w").write(str(compiler.pid))
compiler.wait()
"""


def test_one_that_hangs_is_killed_with_what_it_started(tmp_path):
    noted, start = tmp_path / "pid", time.monotonic()
    verdict = check_in_new_process("warp", 0, [sys.executable, "-c", HANGS, str(noted)], 5.0)
    assert verdict == BackendCheck("its check failed: it did not end within its time limit of 5 s", runs=False)
    assert time.monotonic() - start < 30
    compiler = int(noted.read_text())
    for _ in range(100):  # until the system has seen to it
        try:
            os.kill(compiler, 0)
        except ProcessLookupError:
            break
        if Path(f"/proc/{compiler}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z":
            break
        time.sleep(0.1)
    else:
        pytest.fail("the compiler is still there")


def test_one_that_crashes_is_a_reason_with_its_last_line():
    verdict = of("import os, sys; print('a\\nCUDA driver: bad state', file=sys.stderr, flush=True); os.abort()")
    assert verdict.reason == "its check failed: it ended by signal SIGABRT: CUDA driver: bad state" and not verdict.runs
    assert of("raise ImportError('libcuda.so')").reason.endswith("it ended by status 1: ImportError: libcuda.so")
    assert of("print('no JSON')").reason == of("").reason == "its check failed: it ended by status 0"


def test_one_that_says_yes_is_believed():
    good = BackendCheck("", True, 1e-6, 2e-5, 0.0, 3.1)
    assert of(f"print('compiling'); print({json.dumps(asdict(good))!r})") == good


def test_the_process_that_is_started_is_the_check(monkeypatch, capsys):
    """`cpu` passes on any machine."""
    monkeypatch.setattr(sys, "argv", ["process", "cpu", "0"])
    monkeypatch.setattr("torch.cuda.device", contextlib.nullcontext)
    checking.main()
    assert BackendCheck(**json.loads(capsys.readouterr().out)).reason == ""


@pytest.mark.cuda
@pytest.mark.parametrize("backend", ON_GPU)
def test_a_real_gpu_is_checked_in_a_process_of_its_own(backend):
    need(backend)
    verdict = check_in_new_process(backend, 0)
    assert verdict.runs and not verdict.reason, verdict

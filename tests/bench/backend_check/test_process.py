import sys

import pytest

from tdgbench.bench.backend_check.process import check_in_process

PYTHON = (sys.executable, "-c")


@pytest.mark.slow
def test_a_backend_is_checked_in_another_process():
    verdict = check_in_process("cpu", 0)
    assert verdict.accepts and verdict.spread == 0


def test_an_error_of_the_backend_is_its_verdict():
    """No GPU has this number; without any, torch says that first."""
    verdict = check_in_process("cuda", 99)
    assert not verdict.accepts and "\n" not in verdict.reason
    assert "Error" in verdict.reason


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import os; os.abort()", "ended by SIGABRT: nothing was printed"),
        ("import sys; print('undefined symbol', file=sys.stderr); sys.exit(3)", "ended by status 3: undefined symbol"),
        ("pass", "ended by status 0: nothing was printed"),
    ],
)
def test_a_process_that_ends_without_a_verdict_is_a_reason(code, reason):
    verdict = check_in_process("cuda", 0, (*PYTHON, code))
    assert reason in verdict.reason and not verdict.accepts and not verdict.is_lasting


def test_a_process_that_does_not_end_is_ended():
    verdict = check_in_process("cuda", 0, (*PYTHON, "import time; time.sleep(60)"), seconds=0.5)
    assert verdict.reason == "its check was ended after 0.5 s" and not verdict.is_lasting


def test_a_process_that_cannot_start_is_a_reason():
    verdict = check_in_process("cuda", 0, ("/no/such/python",))
    assert verdict.reason == "its check could not be started (No such file or directory)"


@pytest.mark.cuda
def test_the_gpu_passes_in_another_process():
    verdict = check_in_process("cuda", 0)
    assert verdict.accepts, verdict

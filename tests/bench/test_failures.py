"""Failures of the environment are told from those of a cell; each says what to do."""

import errno
import importlib
import os
import re
from urllib.error import URLError

import pytest
import torch

from methods.gaussian_splatting import GaussianSplatting
from tdgbench.bench import failures
from tdgbench.bench.failures import REMEDIES, message, of_environment
from tdgbench.cells.record import read_all, schema_problems
from tests.helpers.cells import fails, statuses


def recursion(self, iteration):
    return recursion(self, iteration)


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (fails(SystemExit(3)), "its code ended the process with status 3"),
        (fails(MemoryError()), "smaller images (data.width=…)"),
        (recursion, "RecursionError"),
    ],
)
def test_what_is_hardly_an_error_fails_the_cell(tiny_cell, monkeypatch, step, said):
    monkeypatch.setattr(GaussianSplatting, "step", step)
    outcome = tiny_cell()
    assert outcome.status == "failed" and said in outcome.message
    assert said in read_all(tiny_cell.experiment)[0].failure.error


def test_where_a_methods_code_failed_is_said(tiny_cell, monkeypatch):
    monkeypatch.setattr(GaussianSplatting, "step", recursion)
    said = r"RecursionError: .* \(test_failures\.py, line \d+\); traceback: .*/3dgs/.*/seed0/record\.json"
    assert re.search(said, tiny_cell().message)


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


@pytest.mark.parametrize("error", [FULL, torch.OutOfMemoryError("CUDA out of memory")], ids=["disk", "memory"])
def test_a_failure_of_the_environment_is_tried_again(tiny_cell, monkeypatch, error):
    with monkeypatch.context() as patch:
        patch.setattr(GaussianSplatting, "step", fails(error))
        assert tiny_cell().status == "failed"
    (record,) = read_all(tiny_cell.experiment)
    assert record.failure.of_environment and schema_problems((tiny_cell.folder / "record.json").read_text()) == []
    assert tiny_cell().status == "ok"


def test_a_failure_of_the_environment_hides_no_result_of_the_same_settings(tiny_cell, monkeypatch):
    assert tiny_cell().status == "ok"
    with monkeypatch.context() as patch:
        patch.setattr(GaussianSplatting, "step", fails(MemoryError()))
        assert tiny_cell("overwrite=always").status == "failed"
    assert statuses(tiny_cell.experiment) == ["ok"] and tiny_cell().status == "kept"


@pytest.mark.parametrize(
    "error", [ValueError("x"), RuntimeError("out of luck"), FileNotFoundError(2, "no"), KeyError("a")]
)
def test_a_failure_of_the_cell_is_its_own(error):
    assert not of_environment(error)


def raised_from(cause):
    error = ValueError("view001.png cannot be read")
    error.__cause__ = cause
    return error


NUMBERS = "EDQUOT EIO EACCES EPERM ESTALE ETIMEDOUT ENOMEM EROFS EMFILE"
OF_ENVIRONMENT = [
    *(OSError(number, os.strerror(number), "a.png") for number in (getattr(errno, name) for name in NUMBERS.split())),
    MemoryError("Unable to allocate"),
    RuntimeError("CUDA error: device-side assert triggered"),
    RuntimeError("[enforce fail at alloc_cpu.cpp:127] DefaultCPUAllocator: can't allocate memory: you tried …"),
    RuntimeError("can't start new thread"),
    ConnectionResetError(104, "Connection reset by peer"),
    URLError("no route"),
    raised_from(OSError(errno.EIO, "Input/output error")),
]


@pytest.mark.parametrize("error", OF_ENVIRONMENT, ids=lambda error: str(error)[:25])
def test_what_the_machine_caused_is_of_the_environment(error):
    assert of_environment(error) and any(remedy in message(error) for remedy in REMEDIES.values())


def test_the_allocator_of_torch_is_recognised():
    with pytest.raises(RuntimeError) as caught:
        torch.empty(2**60)
    assert of_environment(caught.value) and "data.width" in message(caught.value)


def test_causes_that_lead_back_end():
    one, other = ValueError("one"), ValueError("other")
    one.__cause__, other.__cause__ = other, one
    assert not of_environment(one)


def test_an_error_that_a_system_does_not_know_is_none_of_its_errors(monkeypatch):
    """macOS has no EREMOTEIO: every command imports this module."""
    monkeypatch.delattr(errno, "EREMOTEIO", raising=False)
    importlib.reload(failures)
    assert failures.of_environment(OSError(errno.ENOSPC, "full"))
    monkeypatch.undo()
    importlib.reload(failures)

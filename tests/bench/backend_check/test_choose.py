"""`auto` on machines with and without GPUs, with stand-ins for the GPU and for its backend."""

import multiprocessing
import os
import time
from pathlib import Path

import pytest
import torch

from tdgbench.bench.backend_check import check as checking
from tdgbench.bench.backend_check import choose as choosing
from tdgbench.bench.backend_check.check import Verdict, check
from tdgbench.bench.backend_check.choose import Choice, auto, choose, training_backend, verdict_on
from tdgbench.bench.backend_check.compare import cloud
from tdgbench.bench.backend_check.stored import place_of
from tdgbench.splats.backends.cuda import CudaBackend
from tests.helpers.backends import Raises, StandIn, Unsteady, WrongGradient, register

GOOD = Verdict("", 1e-6, 2e-5, 0.0, 3.1)
IDENTITY = {"gpu": "A", "driver": "1"}


@pytest.fixture
def machine(monkeypatch, tmp_path):
    """A machine with these GPUs, by name: `machine("A", "B")`."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    auto.cache_clear()

    monkeypatch.setattr(choosing, "choose", choose)  # other tests are on the CPU
    monkeypatch.setattr(checking, "scenes", lambda: {"small": lambda: cloud(30, width=20, height=15)})

    def with_gpus(*names, why_not=None, driver="570.1"):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: bool(names))
        monkeypatch.setattr(torch.cuda, "device_count", lambda: len(names))
        monkeypatch.setattr(choosing, "describe_gpu", lambda index: {"name": names[index], "driver": driver})
        monkeypatch.setattr(choosing, "installed_version", lambda: "1.5.3")
        monkeypatch.setattr(CudaBackend, "why_not", lambda self: why_not)

    yield with_gpus
    auto.cache_clear()


@pytest.fixture
def checked(monkeypatch):
    """Checks a stand-in for the GPU's backend, and counts the checks: `checked(StandIn())`, `checked.count`."""

    def of(backend):
        name = register(monkeypatch, backend)

        def run(asked, index):
            assert asked == "cuda"
            of.count += 1
            return check(name)

        return run

    of.count = 0
    return of


def never(backend, gpu):
    pytest.fail("checked")


def test_without_a_gpu_it_is_the_cpu_in_silence(machine, capsys):
    machine()
    assert choose(never) == Choice("cpu", "")
    assert training_backend("auto") == "cpu" and training_backend("reference") == "reference"
    assert capsys.readouterr() == ("", "")


def test_a_gpu_that_is_right_is_taken(machine, checked):
    machine("NVIDIA A")
    choice = choose(checked(StandIn()))
    assert choice.backend == "cuda" and checked.count == 1 and "\n" not in choice.line
    assert choice.line.startswith("NVIDIA A trains: gsplat 1.5.3 agrees with the reference (image within ")
    assert "of 5e-05, gradients within" in choice.line and "; deterministic; checked in" in choice.line


def test_a_stored_verdict_is_not_checked_again(machine, checked):
    machine("A")
    first = choose(checked(StandIn()))
    again = choose(never)
    assert again.backend == "cuda" and "checked earlier" in again.line
    assert first.line.split("; checked")[0] == again.line.split("; checked")[0]
    machine("A", driver="575.0")
    choose(checked(StandIn()))
    assert checked.count == 2


def test_a_gpu_that_is_wrong_is_not_taken_and_stays_so(machine, checked):
    machine("A")
    choice = choose(checked(WrongGradient()))
    assert choice.backend == "cpu"
    assert choice.line.startswith("the CPU trains, not A: gsplat 1.5.3 did not pass its check: gradients of the scene")
    assert "backend=cuda trains with it all the same" in choice.line
    assert choose(never).backend == "cpu"


def test_what_is_not_deterministic_is_said(machine, checked):
    machine("A")
    choice = choose(checked(Unsteady(1e-5)))
    assert choice.backend == "cuda" and "; not deterministic, by 1e-05;" in choice.line


def test_no_memory_is_a_reason_for_now(machine, checked):
    machine("A")
    choice = choose(checked(Raises()))
    assert choice.backend == "cpu" and "OutOfMemoryError: CUDA out of memory" in choice.line
    assert choose(checked(StandIn())).backend == "cuda" and checked.count == 2


def test_a_gpu_without_gsplat_is_named(machine):
    machine("A", "A", why_not="gsplat is not installed: pip install -e '.[cuda]'")
    line = "the CPU trains, not A: gsplat is not installed: pip install -e '.[cuda]'"
    assert choose(never) == Choice("cpu", line)


def test_every_model_has_to_pass(machine):
    machine("A", "A", "B")
    asked = []

    def run(backend, gpu):
        asked.append(gpu)
        return GOOD if gpu == 0 else Verdict("it is wrong")

    choice = choose(run)
    assert asked == [0, 2] and choice.backend == "cpu" and choice.line.startswith("the CPU trains, not B:")


def test_the_line_is_printed_once(machine, monkeypatch, capsys):
    machine("A")
    monkeypatch.setattr(choosing, "check_in_process", lambda backend, gpu: GOOD)
    assert [training_backend("auto") for _ in range(3)] == ["cuda"] * 3
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("backend: A trains: gsplat 1.5.3") and err.count("\n") == 1


@pytest.mark.parametrize("text", ["", "{", '{"identity": {"gpu": "B"}, "verdict": {}}', "[1]"])
def test_a_damaged_file_is_named_and_replaced(machine, capsys, text):
    machine()
    path = place_of(IDENTITY)
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="utf-8")
    assert verdict_on(IDENTITY, lambda: GOOD) == (GOOD, False)
    assert f"{path} is not used, and the GPU is checked again" in capsys.readouterr().err
    assert verdict_on(IDENTITY, lambda: pytest.fail("checked")) == (GOOD, True)


def test_without_a_folder_it_is_checked_each_time(machine, monkeypatch, tmp_path, capsys):
    machine()
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    for _ in range(2):
        assert verdict_on(IDENTITY, lambda: GOOD) == (GOOD, False)
        assert "the check of the GPU is not remembered" in capsys.readouterr().err


def _slow_check(counter):
    """One line for each check of all processes."""

    def run():
        with Path(counter).open("a", encoding="utf-8") as file:
            file.write("x")
        time.sleep(1.0)
        return GOOD

    return run


def _ask(home, counter, answers):
    os.environ["XDG_CACHE_HOME"] = home
    answers.put(verdict_on(IDENTITY, _slow_check(counter)))


def test_processes_that_begin_together_check_once(tmp_path):
    context = multiprocessing.get_context("fork")
    answers, counter = context.Queue(), tmp_path / "checks"
    workers = [context.Process(target=_ask, args=(str(tmp_path), str(counter), answers)) for _ in range(3)]
    for worker in workers:
        worker.start()
    found = [answers.get(timeout=60) for _ in workers]
    for worker in workers:
        worker.join(timeout=60)
    assert counter.read_text() == "x"
    assert {verdict for verdict, _ in found} == {GOOD} and sorted(is_stored for _, is_stored in found) == [
        False,
        True,
        True,
    ]


@pytest.mark.cuda
def test_a_real_gpu_is_taken_or_named(monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(choosing, "choose", choose)
    auto.cache_clear()
    try:
        assert training_backend("auto") == "cuda", capsys.readouterr().err
        auto.cache_clear()
        assert training_backend("auto") == "cuda" and "checked earlier" in capsys.readouterr().err
    finally:
        auto.cache_clear()

"""`auto` on machines with and without GPUs, with stand-ins for the GPU and for its backend."""

import pytest
import torch

from tdgbench.bench.backend_check import check as checking
from tdgbench.bench.backend_check import choose as choosing
from tdgbench.bench.backend_check.check import BackendCheck, check
from tdgbench.bench.backend_check.choose import AutoBackend, auto, choose, training_backend
from tdgbench.bench.backend_check.compare import cloud
from tdgbench.splats.backends import ON_GPU
from tdgbench.splats.backends.backend import Backend
from tdgbench.splats.backends.cuda import CudaBackend
from tdgbench.splats.backends.warp import WarpBackend
from tests.helpers.backends import StandIn, Unsteady, WrongGradient, register

GOOD = BackendCheck("", True, 1e-6, 2e-5, 0.0, 3.1)


@pytest.fixture
def machine(monkeypatch):
    """A machine with these GPUs, by name: `machine("A", "B")`; why_not: of gsplat, no_warp: of Warp."""
    auto.cache_clear()
    monkeypatch.setattr(choosing, "choose", choose)  # other tests are on the CPU
    monkeypatch.setattr(checking, "scenes", lambda: {"small": cloud(30, width=20, height=15)})

    def with_gpus(*names, why_not=None, no_warp="no Warp"):
        monkeypatch.setattr(torch.cuda, "is_available", lambda: bool(names))
        monkeypatch.setattr(torch.cuda, "device_count", lambda: len(names))
        monkeypatch.setattr(torch.cuda, "get_device_name", lambda index: names[index])
        versions = {"gsplat": None if why_not else "1.5.3", "warp-lang": None if no_warp else "1.19.0"}
        monkeypatch.setattr(Backend, "version", lambda self: versions[self.package])
        monkeypatch.setattr(WarpBackend, "why_not", lambda self: no_warp)
        monkeypatch.setattr(CudaBackend, "why_not", lambda self: why_not)

    yield with_gpus
    auto.cache_clear()


@pytest.fixture
def checked(monkeypatch):
    """Checks a stand-in for the GPU's backend: `checked(StandIn())`."""

    def of(backend):
        name = register(monkeypatch, backend)
        return lambda asked, device: check(name)

    return of


def never(backend, device):
    pytest.fail("checked")


def test_without_a_gpu_it_is_the_cpu_in_silence(machine, capsys):
    machine()
    assert choose(never) == AutoBackend("cpu", "")
    assert training_backend("auto") == "cpu" and training_backend("reference") == "reference"
    assert capsys.readouterr() == ("", "")


def test_a_gpu_that_is_right_is_taken(machine, checked):
    machine("NVIDIA A")
    choice = choose(checked(StandIn()))
    assert choice.backend == "cuda" and "\n" not in choice.line
    assert choice.line.startswith("NVIDIA A trains: gsplat 1.5.3 agrees with the reference (image within ")
    assert "of 5e-05, gradients within" in choice.line and "; deterministic; checked in" in choice.line
    assert choice.line.endswith("; not warp: no Warp")


def test_a_gpu_that_is_wrong_is_not_taken(machine, checked):
    machine("A")
    choice = choose(checked(WrongGradient()))
    assert choice.backend == "cpu"
    assert choice.line.startswith(
        "the CPU trains, not A: warp: no Warp; cuda: gsplat 1.5.3 did not pass its check on A: "
    )
    assert "gradients of the scene 'small'" in choice.line
    assert "backend=cuda trains with it all the same" in choice.line


def test_warp_comes_before_gsplat(machine):
    """Its check decides: gsplat is then checked, and only then the CPU trains."""
    machine("A", no_warp=None)
    asked = []

    def run(backend, device):
        asked.append(backend)
        return BackendCheck("it is wrong") if len(asked) in (2, 4, 5) else GOOD

    choice = choose(run)
    assert (
        choice.backend == "warp" and choice.line.startswith("A trains: warp-lang 1.19.0 agrees") and asked == ["warp"]
    )
    choice = choose(run)
    assert choice.backend == "cuda" and asked == ["warp", "warp", "cuda"]
    assert choice.line.startswith("A trains: gsplat 1.5.3") and "; not warp: warp-lang 1.19.0 did not" in choice.line
    choice = choose(run)
    assert choice.backend == "cpu" and asked[3:] == ["warp", "cuda"] and "; cuda: gsplat 1.5.3 did not" in choice.line


def test_what_is_not_deterministic_is_said(machine, checked):
    machine("A")
    choice = choose(checked(Unsteady(1e-5)))
    assert choice.backend == "cuda" and "; not deterministic, by 1e-05;" in choice.line


def test_a_gpu_without_gsplat_is_named(machine):
    machine("A", "A", why_not="gsplat is not installed: pip install -e '.[cuda]'")
    line = "the CPU trains, not A: warp: no Warp; cuda: gsplat is not installed: pip install -e '.[cuda]'"
    assert choose(never) == AutoBackend("cpu", line)


def test_every_model_has_to_pass(machine):
    machine("A", "A", "B")
    verdicts = iter([GOOD, BackendCheck("it is wrong")])
    choice = choose(lambda backend, device: next(verdicts))
    assert choice.backend == "cpu" and "check on B: it is wrong" in choice.line and not list(verdicts)


def test_the_line_is_printed_once(machine, monkeypatch, capsys):
    machine("A")
    monkeypatch.setattr(choosing, "check_in_new_process", lambda backend, device: GOOD)
    assert [training_backend("auto") for _ in range(3)] == ["cuda"] * 3
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 2 and "\nbackend: A trains: gsplat 1.5.3" in err


def test_compiling_is_announced_before_it_begins(machine, monkeypatch, capsys):
    """gsplat compiles when it is imported, not in this process. A backend that is not installed compiles nothing."""
    machine("A")
    monkeypatch.setattr(CudaBackend, "why_not", lambda self: pytest.fail("imported"))
    said = []

    def run(backend, device):
        said.append(capsys.readouterr().err)
        return BackendCheck("gsplat finds no nvcc", runs=False)

    assert choose(run).line == "the CPU trains, not A: warp: no Warp; cuda: gsplat finds no nvcc"
    assert said == ["note: checking gsplat 1.5.3 against the reference; its first use compiles kernels\n"]


@pytest.mark.cuda
def test_a_real_gpu_is_taken_or_named(monkeypatch, capsys):
    monkeypatch.setattr(choosing, "choose", choose)
    auto.cache_clear()
    try:
        assert training_backend("auto") in ON_GPU, capsys.readouterr().err
    finally:
        auto.cache_clear()

"""The check accepts a backend that is right and refuses those that are wrong, each for its reason."""

import contextlib
import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from tdgbench.bench.backend_check import check as checking
from tdgbench.bench.backend_check.check import BackendCheck, check, check_in_new_process, scenes
from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE, cloud, expected, render
from tdgbench.splats.backends import ON_GPU, cpu
from tdgbench.splats.view import AS_3DGS, Blending
from tests.helpers.backends import (
    NoAbsgrad,
    NoBackground,
    NoRadii,
    NotFinite,
    Raises,
    StandIn,
    Unsteady,
    WrongGradient,
    WrongValue,
    need,
    register,
)


@pytest.fixture
def verdict_on(monkeypatch):
    return lambda backend: check(register(monkeypatch, backend))


@pytest.fixture
def one_scene(monkeypatch):
    """Wrong backends show it on the first scene."""
    first = dict([next(iter(scenes().items()))])
    monkeypatch.setattr(checking, "scenes", lambda: first)


def test_the_scenes_hold_what_they_are_for():
    """Degrees, channels, several tiles; Gaussians that no ray sees; few pixels that a rounding error could flip."""
    made = scenes()
    assert len(made) == 4
    assert {(c.degree, c.colors.shape[-1]) for c in made.values()} == {(3, 1), (None, 3), (1, 3), (1, 1)}
    assert (expected(made["opaque walls"], "reference").rendered.image[..., -1] > 0.999).double().mean() > 0.3
    for scene in made.values():
        assert scene.width > 48 and scene.height > 32
        want = expected(scene, "reference")
        assert want.undecided.double().mean() < 0.01
        assert all(gradient.norm() > 0.1 for gradient in want.rendered.gradients.values())
    unseen = expected(made["hidden, faint and opaque"], "reference").rendered.gradients["means"][:45].norm(dim=1)
    assert (unseen == 0).all()


def test_the_reference_in_float32_passes(verdict_on):
    verdict = verdict_on(StandIn())
    assert not verdict.reason and verdict.spread == 0
    assert 0 < verdict.image < IMAGE_TOLERANCE / 10 and 0 < verdict.gradients < GRADIENT_TOLERANCE / 10


def test_the_cpu_passes():
    verdict = check("cpu")
    assert not verdict.reason and verdict.spread == 0 and verdict.seconds > 0


def with_error(error: Exception) -> Raises:
    backend = Raises()
    backend.error = error
    return backend


REFUSED = {
    "wrong value": (WrongValue(), "image of the scene 'gray, harmonics of degree 3' is wrong by ", "allowed is 5e-05"),
    "wrong gradient": (WrongGradient(), "gradients of the scene 'gray", "allowed is 0.0002"),
    "no radii": (NoRadii(), "radii of the scene 'gray, harmonics of degree 3' are 0 of ", " Gaussians that it shows"),
    "NaN": (NotFinite(), "image of the scene", "is not finite"),
    "error": (with_error(AssertionError("torch.Size([120, 16])")), "AssertionError: ", "torch.Size([120, 16])"),
    "no memory": (Raises(), "OutOfMemoryError: CUDA out of memory. Tried to allocate 2.00 MiB.", ""),
}


@pytest.mark.parametrize(("backend", "start", "end"), REFUSED.values(), ids=REFUSED)
def test_a_backend_that_is_wrong_is_refused_with_the_reason(verdict_on, one_scene, backend, start, end):
    reason = verdict_on(backend).reason
    assert reason.startswith(start) and reason.endswith(end) and "\n" not in reason


@pytest.mark.parametrize(("backend", "what"), [(NoBackground(), "image"), (NoAbsgrad(), "gradients")])
def test_a_background_and_absolute_gradients_are_compared(verdict_on, backend, what):
    assert verdict_on(backend).reason.startswith(f"{what} of the scene 'colours, many tiles'")


def test_what_is_not_deterministic_is_told_and_not_refused(verdict_on, one_scene):
    verdict = verdict_on(Unsteady(1e-5))
    assert not verdict.reason and 1e-6 < verdict.spread < 1e-4


def test_what_is_not_deterministic_beyond_the_tolerance_is_refused(verdict_on, one_scene):
    """Its first render is right."""
    backend = Unsteady(1e-2)
    backend.renders = 1
    verdict = verdict_on(backend)
    assert verdict.reason.startswith("image") and backend.renders == 3


def image_error() -> float:
    scene = cloud(30)
    want = expected(scene, "cpu")
    return want.errors(render(scene, "cpu", want.weights)).image


def test_a_backend_with_constants_of_its_own_is_compared_with_these(monkeypatch):
    """It is asked for the default ones, as gsplat is, and nevertheless blends with its own."""
    own, asked, original = Blending(max_alpha=0.5), [], cpu.CpuBackend.render

    def with_its_own(self, gaussians, camera, options):
        asked.append(options.blending)
        return original(self, gaussians, camera, options._replace(blending=own))

    monkeypatch.setattr(cpu.CpuBackend, "render", with_its_own)
    assert image_error() > 0.01
    monkeypatch.setattr(cpu.CpuBackend, "constants", lambda self, packages=None: own)
    assert image_error() < 1e-6 and set(asked) == {AS_3DGS}


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
    verdict = check_in_new_process("warp", 0, [sys.executable, "-c", HANGS, str(noted)], 2.0)
    assert verdict == BackendCheck("its check failed: it did not end within its time limit of 2 s", runs=False)
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
    watched = []
    monkeypatch.setattr(sys, "argv", ["process", "cpu", "0", "7"])
    monkeypatch.setattr(checking, "watch", lambda parent, end: watched.append(parent))
    monkeypatch.setattr("torch.cuda.device", contextlib.nullcontext)
    checking.main()
    assert BackendCheck(**json.loads(capsys.readouterr().out)).reason == "" and watched == [7]


@pytest.mark.cuda
@pytest.mark.parametrize("backend", ON_GPU)
def test_a_real_gpu_is_checked_in_a_process_of_its_own(backend):
    need(backend)
    verdict = check_in_new_process(backend, 0)
    assert verdict.runs and not verdict.reason, verdict

"""Which backend `backend=auto` trains with: the GPU's if it passes its check on every GPU here, else the CPU's."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

import torch

from tdgbench.bench.backend_check.check import Verdict
from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE
from tdgbench.bench.backend_check.process import check_in_process
from tdgbench.bench.backend_check.stored import Identity, check_version, place_of, read_verdict, write_verdict
from tdgbench.bench.gpu import describe_gpu
from tdgbench.bench.lock import file_lock
from tdgbench.splats.backends import AUTO, load_backend
from tdgbench.splats.backends.cuda import installed_version
from tdgbench.terminal import say

GPU = "cuda"  # type of device
RETRY_SECONDS = 0.5


class Choice(NamedTuple):
    """What `auto` stands for."""

    backend: str
    line: str = ""  # what was found of the GPU, in one line; empty without one


class Found(NamedTuple):
    """A verdict and where it comes from."""

    verdict: Verdict
    is_stored: bool


def training_backend(name: str) -> str:
    """Name of the backend that trains; `auto` is chosen once in a process, which prints why."""
    return auto().backend if name == "auto" else name


@cache
def auto() -> Choice:
    """What `auto` stands for in this process."""
    choice = choose(check_in_process)
    if choice.line:
        say(choice.line, "backend:", "bold", stderr=True)
    return choice


def choose(run: Callable[[str, int], Verdict]) -> Choice:
    """The backend to train with. run: checks a backend on a GPU (CUDA's index) where no verdict is stored.

    Without a GPU it is the CPU's, with nothing to say. Where GPUs differ, every model has to pass.
    """
    if not torch.cuda.is_available():
        return Choice(AUTO["cpu"])
    backend, models = AUTO[GPU], _models()
    names, lines = " and ".join(models), []
    reason = load_backend(backend).why_not()
    if reason is not None:
        return Choice(AUTO["cpu"], f"the CPU trains, not {names}: {reason}")
    for name, (index, identity) in models.items():
        found = verdict_on(identity, lambda index=index: run(backend, index))  # type: ignore[misc]
        if not found.verdict.accepts:
            return Choice(AUTO["cpu"], f"the CPU trains, not {name}: {_refusal(backend, identity, found)}")
        lines.append(f"{name} trains: {_acceptance(identity, found)}")
    return Choice(backend, "; ".join(lines))


def verdict_on(identity: Identity, run: Callable[[], Verdict]) -> Found:
    """The stored verdict on an identity, or that of a check, which only one process runs at a time.

    A stored file that cannot be used is named and replaced. Without a folder for caches, every process checks.
    """
    try:
        path = place_of(identity)
        lock = path.with_suffix(".lock")
        with file_lock(lock):
            pass
    except (OSError, RuntimeError) as error:
        say(f"the check of the GPU is not remembered: {error}", "note:", "yellow", stderr=True)
        return Found(run(), False)
    while True:
        with file_lock(lock) as acquired:
            if acquired:
                stored = _readable(path, identity)
                return Found(_checked(path, identity, run), False) if stored is None else Found(stored, True)
        time.sleep(RETRY_SECONDS)


def _checked(path: Path, identity: Identity, run: Callable[[], Verdict]) -> Verdict:
    """Verdict of a new check, stored if it will be the same the next time."""
    verdict = run()
    if verdict.is_lasting:
        try:
            write_verdict(path, identity, verdict)
        except OSError as error:
            say(f"the check of the GPU is not remembered: {error}", "note:", "yellow", stderr=True)
    elif path.exists():
        with suppress(OSError):
            path.unlink()
    return verdict


def _readable(path: Path, identity: Identity) -> Verdict | None:
    try:
        return read_verdict(path, identity)
    except ValueError as error:
        say(f"{path} is not used, and the GPU is checked again: {error}", "note:", "yellow", stderr=True)
        return None


def _models() -> dict[str, tuple[int, Identity]]:
    """Each GPU model here by name, with the index of one of them and what a verdict on it depends on."""
    models: dict[str, tuple[int, Identity]] = {}
    for index in range(torch.cuda.device_count()):
        gpu = describe_gpu(index)
        if gpu is not None:
            models.setdefault(gpu["name"], (index, _identity(gpu["name"], gpu["driver"])))
    return models


def _identity(name: str, driver: str | None) -> Identity:
    return {
        "gpu": name,
        "driver": driver,
        "cuda": torch.version.cuda,
        "torch": torch.__version__,
        "gsplat": installed_version(),
        "check": check_version(),
    }


def _acceptance(identity: Identity, found: Found) -> str:
    verdict = found.verdict
    sums = "deterministic" if verdict.spread == 0 else f"not deterministic, by {verdict.spread:.0e}"
    return (
        f"gsplat {identity['gsplat']} agrees with the reference (image within {verdict.image:.0e} of "
        f"{IMAGE_TOLERANCE:g}, gradients within {verdict.gradients:.0e} of {GRADIENT_TOLERANCE:g}; {sums}; "
        f"{_when(found)})"
    )


def _refusal(backend: str, identity: Identity, found: Found) -> str:
    return (
        f"gsplat {identity['gsplat']} did not pass its check: {found.verdict.reason} ({_when(found)}; "
        f"backend={backend} trains with it all the same)"
    )


def _when(found: Found) -> str:
    return "checked earlier" if found.is_stored else f"checked in {found.verdict.seconds:g} s"

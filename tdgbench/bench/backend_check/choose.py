"""Which backend `backend=auto` trains with: the first of the GPU's that agrees with the reference, else the CPU's.

Once in a process, before its first training, another process renders four small scenes several times there: values and
gradients count.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import torch

from tdgbench.bench.backend_check.check import BackendCheck, check_in_new_process
from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE
from tdgbench.splats.backends import ON_GPU, load_backend
from tdgbench.terminal import say

CPU = "cpu"  # the backend without a GPU


class AutoBackend(NamedTuple):
    """The backend that `auto` chooses."""

    backend: str
    line: str = ""  # why, in one line; empty without a GPU


def training_backend(name: str) -> str:
    """Return the name of the backend that trains; `auto` is chosen once in a process, which prints why."""
    return auto().backend if name == "auto" else name


@cache
def auto() -> AutoBackend:
    """Return the choice of this process; the first call makes it and prints why."""
    choice = choose(check_in_new_process)
    if choice.line:
        say(choice.line, "backend:", "bold", stderr=True)
    return choice


def choose(run: Callable[[str, int], BackendCheck]) -> AutoBackend:
    """Return the backend to train with. run: checks a backend on a CUDA device, by its index.

    Without a GPU it is the CPU's, with nothing to say. Where GPUs differ, every model has to pass.
    """
    if not torch.cuda.is_available():
        return AutoBackend(CPU)
    models = {torch.cuda.get_device_name(i): i for i in reversed(range(torch.cuda.device_count()))}
    reasons: list[tuple[str, str]] = []
    for backend in ON_GPU:
        agrees, reason = _try(backend, models, run)
        if not reason:
            return AutoBackend(backend, "; ".join([agrees, *(f"not {other}: {why}" for other, why in reasons)]))
        reasons.append((backend, reason))
    names = " and ".join(sorted(models))
    return AutoBackend(CPU, f"the CPU trains, not {names}: {'; '.join(f'{other}: {why}' for other, why in reasons)}")


def _try(backend: str, models: dict[str, int], run: Callable[[str, int], BackendCheck]) -> tuple[str, str]:
    """Return what the check of a backend found, and why it is refused, or "". models: an index of each GPU model."""
    own = load_backend(backend)
    package = f"{own.package} {own.version()}"
    reason = own.why_not() if own.version() is None else None  # else its import may compile: not in this process
    if reason is not None:
        return "", reason
    note = f"checking {package} against the reference; its first use compiles kernels"
    say(note, "note:", "yellow", stderr=True)
    lines = []
    for name, index in sorted(models.items()):
        verdict = run(backend, index)
        if not verdict.runs:
            return "", verdict.reason
        if verdict.reason:
            return "", (
                f"{package} did not pass its check on {name}: {verdict.reason} (checked in {verdict.seconds:g} s; "
                f"backend={backend} trains with it all the same)"
            )
        sums = "deterministic" if verdict.spread == 0 else f"not deterministic, by {verdict.spread:.0e}"
        lines.append(
            f"{name} trains: {package} agrees with the reference (image within {verdict.image:.0e} of "
            f"{IMAGE_TOLERANCE:g}, gradients within {verdict.gradients:.0e} of {GRADIENT_TOLERANCE:g}; {sums}; "
            f"checked in {verdict.seconds:g} s)"
        )
    return "; ".join(lines), ""

"""Compare values and gradients of a backend on four small scenes with the float64 reference.

A process of its own does it: a compiler that hangs, or a driver that crashes, costs the backend and nothing else.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass

import torch

from tdgbench.bench.backend_check.compare import (
    GRADIENT_TOLERANCE,
    IMAGE_TOLERANCE,
    NAMES,
    Cloud,
    Rendered,
    cloud,
    expected,
    render,
)
from tdgbench.bench.failures import message
from tdgbench.children import run_limited
from tdgbench.resources import PACKAGE
from tdgbench.signals import watch
from tdgbench.splats.backends import load_backend
from tdgbench.text import shortened

LIMIT_SECONDS = 3600.0  # gsplat compiles for minutes, on two slow cores for half an hour
REPETITIONS = 3
COMPARED = (*NAMES, "means2d")  # density control reads the last one


@dataclass(frozen=True)
class BackendCheck:
    """Outcome of a check. Errors are the largest ones so far, relative; NaN where one is not finite."""

    reason: str = ""  # why the backend must not train; empty if it may
    runs: bool = True  # whether it runs at all
    image: float = 0.0
    gradients: float = 0.0
    spread: float = 0.0  # largest difference between repetitions, as the errors; 0: equal bytes
    seconds: float = 0.0


def check_in_new_process(
    backend: str, device: int, command: Sequence[str] | None = None, limit: float = LIMIT_SECONDS
) -> BackendCheck:
    """Check a backend on a CUDA device (its index) in a new process; what ends that is a reason to refuse the backend.

    After `limit` seconds, it is killed with the compilers that it started. command: stands in for the check in tests.
    """
    own = [sys.executable, "-m", __name__, backend, str(device), str(os.getpid())]
    ended = run_limited(command or own, limit, PACKAGE.parent)
    if ended.status == 0:
        with suppress(ValueError, TypeError, IndexError):
            return BackendCheck(**json.loads(ended.out.strip().splitlines()[-1]))
    limited = f" of {limit:g} s" if ended.status is None else ""
    return BackendCheck(shortened(f"its check failed: {ended.why}{limited}"), runs=False)


def check(backend: str) -> BackendCheck:
    """Compare a backend with the reference, each scene several times. An exception refuses the backend."""
    start = time.perf_counter()
    missing = load_backend(backend).why_not()
    if missing is not None:
        return BackendCheck(missing, runs=False)
    worst = {"image": 0.0, "gradients": 0.0, "spread": 0.0}
    reason = ""
    try:
        for name, scene in scenes().items():
            reason = reason or _compare(name, scene, backend, worst)
    except Exception as error:
        reason = shortened(message(error))
    return BackendCheck(reason, True, **worst, seconds=round(time.perf_counter() - start, 1))


def scenes() -> dict[str, Cloud]:
    """Return the four scenes, by what they are like.

    Thermal values as most trainings hold them; more Gaussians in more tiles, so that sums over tiles have an order to
    lose, over a background, with absolute gradients; Gaussians behind and beside the camera, below the threshold of
    alpha, near its cap, thin and large; walls behind which no light is left: a backward pass that takes transmittance
    as 1 − alpha is off by 8e-5 there.
    """
    extremes = cloud(100, seed=3, width=50, height=40, degree=1, channels=3)
    extremes.means[:15, 2] *= -1
    extremes.means[15:30, 0] += 40.0
    extremes.opacities[30:45] = 1 / 300
    extremes.opacities[45:60] = 0.98
    extremes.scales[60:75, 1:] = 0.005
    extremes.scales[75:80] = 3.0
    walls = cloud(300, seed=5, width=60, height=44, degree=1)
    walls.opacities.clamp_min_(0.95)
    colours = cloud(200, seed=2, width=72, height=56, channels=3)
    colours.background, colours.absgrad = torch.tensor([0.2, 0.9, 0.5]), True
    return {
        "gray, harmonics of degree 3": cloud(100, seed=1, width=53, height=37, degree=3),
        "colours, many tiles": colours,
        "hidden, faint and opaque": extremes,
        "opaque walls": walls,
    }


def _compare(name: str, scene: Cloud, backend: str, worst: dict[str, float]) -> str:
    """Render a scene several times and raise the `worst` errors. Returns why the backend is refused, or nothing."""
    want = expected(scene, backend)
    first: Rendered | None = None
    compared = (*COMPARED, "absgrad") if scene.absgrad else COMPARED
    for _ in range(REPETITIONS):
        got = render(scene, backend, want.weights)
        errors = want.errors(got, compared)
        hidden = int(((got.radii <= 0) & (want.rendered.gradients["means2d"] != 0).any(dim=1)).sum())
        if hidden:  # density control would not see them
            return f"radii of the scene '{name}' are 0 of {hidden} Gaussians that it shows"
        limits = {"image": (errors.image, IMAGE_TOLERANCE), "gradients": (errors.gradients, GRADIENT_TOLERANCE)}
        for what, (error, limit) in limits.items():
            worst[what] = error if math.isnan(error) else max(worst[what], error)
            if not error <= limit:  # NaN is not
                size = f"wrong by {error:.1e}, allowed is {limit:g}" if math.isfinite(error) else "not finite"
                return f"{what} of the scene '{name}' {'is' if what == 'image' else 'are'} {size}"
        first = first or got
        worst["spread"] = max(worst["spread"], _spread(first, got))
    return ""


def _spread(first: Rendered, other: Rendered) -> float:
    """Return the largest difference of two results of one scene: of a pixel, or of a gradient relative to its norm."""
    parts = [(first.image - other.image).abs().max()]
    for name in COMPARED:
        gradient = first.gradients[name]
        parts.append((gradient - other.gradients[name]).norm() / gradient.norm().clamp_min(1e-12))
    return torch.stack(parts).max().item()


def main() -> None:
    """Check the backend that the first argument names on the device of the second; write the outcome as JSON.

    The third is the process that started this one. If that is killed, this one ends with its group: its compilers.
    """
    watch(int(sys.argv[3]), lambda: os.killpg(0, signal.SIGKILL))
    with torch.cuda.device(int(sys.argv[2])):
        sys.stdout.write(json.dumps(asdict(check(sys.argv[1]))) + "\n")


if __name__ == "__main__":
    main()

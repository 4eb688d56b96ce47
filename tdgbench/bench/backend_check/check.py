"""Check a backend: values and gradients of three small scenes against the float64 reference, and determinism."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

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
from tdgbench.bench.failures import message, of_environment
from tdgbench.text import one_line, shortened

REPETITIONS = 3
COMPARED = (*NAMES, "means2d")  # density control reads the last one
LONGEST_REASON = 300  # characters


@dataclass(frozen=True)
class Verdict:
    """Outcome of a check. Errors are the largest ones so far, relative; None where one is not finite or not known."""

    reason: str = ""  # why the backend must not train; empty if it may
    image: float | None = None
    gradients: float | None = None
    spread: float | None = None  # largest difference between repetitions, as the errors; 0: equal bytes
    seconds: float = 0.0
    is_lasting: bool = True  # not due to memory, device or disk, which may have changed at the next check

    def __post_init__(self) -> None:
        if not self.reason and None in (self.image, self.gradients, self.spread):
            raise ValueError("a backend that may train has errors that were measured")

    @property
    def accepts(self) -> bool:
        """Whether the backend may train."""
        return not self.reason


def scenes() -> dict[str, Callable[[], Cloud]]:
    """The three scenes, by what they are like."""
    return {"gray, harmonics of degree 3": _gray, "colours, many tiles": _colors, "hidden, faint and opaque": _extremes}


def check(backend: str) -> Verdict:
    """Compare a backend with the reference, each scene several times. Never raises an Exception: that is a verdict."""
    start = time.perf_counter()
    worst = {"image": 0.0, "gradients": 0.0, "spread": 0.0}
    reason, is_lasting = "", True
    try:
        for name, make in scenes().items():
            reason = _compare(name, make(), backend, worst)
            if reason:
                break
    except Exception as error:
        reason, is_lasting = shortened(one_line(message(error)), LONGEST_REASON), not of_environment(error)
        worst = {}
    found = {name: value if math.isfinite(value) else None for name, value in worst.items()}
    return Verdict(reason, **found, seconds=round(time.perf_counter() - start, 1), is_lasting=is_lasting)


def _compare(name: str, scene: Cloud, backend: str, worst: dict[str, float]) -> str:
    """Render a scene several times and raise the `worst` errors. Returns why the backend is refused, or nothing."""
    want = expected(scene, backend)
    first: Rendered | None = None
    for _ in range(REPETITIONS):
        got = render(scene, backend, want.weights)
        errors = want.errors(got, COMPARED)
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
    """Largest difference of two results of one scene: of a pixel, or of a gradient relative to its norm; 0: equal."""
    parts = [(first.image - other.image).abs().max()]
    for name in COMPARED:
        gradient = first.gradients[name]
        parts.append((gradient - other.gradients[name]).norm() / gradient.norm().clamp_min(1e-12))
    return torch.stack(parts).max().item()


def _gray() -> Cloud:
    """Thermal values as most trainings hold them."""
    return cloud(100, seed=1, width=53, height=37, degree=3)


def _colors() -> Cloud:
    """More Gaussians in more tiles, so that sums over tiles have an order to lose."""
    return cloud(200, seed=2, width=72, height=56, channels=3)


def _extremes() -> Cloud:
    """Gaussians behind the camera and beside its image, below the threshold of alpha, near its cap, thin and large."""
    scene = cloud(100, seed=3, width=50, height=40, degree=1, channels=3)
    scene.means[:15, 2] *= -1
    scene.means[15:30, 0] += 40.0
    scene.opacities[30:45] = 1 / 300
    scene.opacities[45:60] = 0.98
    scene.scales[60:75, 1:] = 0.005
    scene.scales[75:80] = 3.0
    return scene

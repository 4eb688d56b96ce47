"""Stress: gradients of the reference and of a backend against finite differences; random scenes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from tdgbench.experiments.error_time.clouds import Cloud
from tdgbench.experiments.stress.case import Case, Close
from tdgbench.experiments.stress.compare import NAMES, cloud, compared, render
from tdgbench.experiments.stress.outcome import Observed
from tdgbench.splats.backends import load_backend
from tdgbench.splats.blending import Blending

FAMILY = "gradients"
STEP = 1e-6
WITHOUT_THRESHOLDS = Blending(min_alpha=1e-9, min_transmittance=0.0)  # thresholds have no derivative
RANDOM_SCENES = 40


def cases() -> list[Case]:
    """Every case of this family."""
    parameters = [
        Case(FAMILY, f"finite differences of {name}, degree {degree}", Close(), _differences(name, degree))
        for degree in (None, 3)
        for name in NAMES
        if degree is None or name in ("means", "colors")
    ]
    return [*parameters, Case(FAMILY, f"{RANDOM_SCENES} random scenes", Close(), _random_scenes)]


def _differences(name: str, degree: int | None) -> Callable[[str], Observed]:
    """Central differences of the float64 reference in every element of one parameter."""

    def run(backend: str) -> Observed:
        scene = cloud(4, seed=30, width=9, height=7, degree=degree)
        scene.scales = scene.scales * 3
        weights = torch.randn(7, 9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        constants = load_backend(backend).constants() or WITHOUT_THRESHOLDS
        smooth = replace(constants, min_alpha=1e-9, min_transmittance=0.0)

        def total(changed: Cloud) -> float:
            return (render(changed, "reference", None, smooth)[0] * weights).sum().item()

        at = getattr(scene, name).double()
        slope = torch.zeros_like(at)
        for i in range(at.numel()):
            moved = []
            for sign in (1, -1):
                values = at.clone()
                values.view(-1)[i] += sign * STEP
                changed = replace(scene, **{n: getattr(scene, n).double() for n in NAMES})
                setattr(changed, name, values)
                moved.append(total(changed))
            slope.view(-1)[i] = (moved[0] - moved[1]) / (2 * STEP)
        exact = render(scene, "reference", weights, smooth)[1][name]
        got = render(scene, backend, weights, constants)[1][name]
        size = slope.norm()
        worst = max(((exact - slope).norm() / size).item(), ((got - slope).norm() / size).item())
        return Observed(f"{at.numel()} elements", {"image": 0.0, "gradients": worst})

    return run


@dataclass(frozen=True)
class Draw:
    """Numbers that define a random scene."""

    count: int
    seed: int
    width: int
    height: int
    log_scale: float
    degree: int | None


SMALLEST = Draw(1, 0, 1, 1, -8.0, None)
LARGEST = Draw(60, 2**20, 50, 40, 2.0, 3)


def draws(count: int) -> list[Draw]:
    """Random scenes between two limits: first SMALLEST and LARGEST, then each number once at each of its limits."""
    rng = np.random.default_rng(0)
    found = [SMALLEST, LARGEST]
    for name in ("count", "width", "height", "log_scale", "degree"):
        found += [replace(_draw(rng), **{name: getattr(limit, name)}) for limit in (SMALLEST, LARGEST)]
    return (found + [_draw(rng) for _ in range(count)])[:count]


def _draw(rng: np.random.Generator) -> Draw:
    low, high = SMALLEST, LARGEST
    return Draw(
        count=int(rng.integers(low.count, high.count, endpoint=True)),
        seed=int(rng.integers(low.seed, high.seed, endpoint=True)),
        width=int(rng.integers(low.width, high.width, endpoint=True)),
        height=int(rng.integers(low.height, high.height, endpoint=True)),
        log_scale=float(rng.uniform(low.log_scale, high.log_scale)),
        degree=[None, 0, 1, 2, 3][rng.integers(5)],
    )


def _random_scenes(backend: str) -> Observed:
    """The worst error over random scenes."""
    worst = {"image": 0.0, "gradients": 0.0}
    for drawn in draws(RANDOM_SCENES):
        scene = cloud(drawn.count, drawn.seed, drawn.width, drawn.height, drawn.degree)
        scene.scales = scene.scales * torch.tensor(drawn.log_scale).exp()
        errors = compared(scene, backend, drawn.seed).numbers
        worst = {name: _larger(errors[name], value) for name, value in worst.items()}
    return Observed("the worst", worst)


def _larger(a: float, b: float) -> float:
    """The larger number; NaN if any is."""
    return math.nan if math.isnan(a) or math.isnan(b) else max(a, b)

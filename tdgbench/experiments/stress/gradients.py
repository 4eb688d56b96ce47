"""Stress: gradients of the reference and of a backend against finite differences; random scenes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch

from tdgbench.bench.backend_check.compare import NAMES, Cloud, cloud, render
from tdgbench.experiments.stress.case import Case, Close, Observed
from tdgbench.experiments.stress.clouds import compared
from tdgbench.splats.backends import load_backend
from tdgbench.splats.blending import Blending

FAMILY = "gradients"
STEP = 1e-6
WITHOUT_THRESHOLDS = Blending(min_alpha=1e-9, min_transmittance=0.0)  # thresholds have no derivative
RANDOM_SCENES = 40
SMALLEST, LARGEST = (1, 1, 1), (60, 50, 40)  # Gaussians, width, height
DEGREES = (None, 0, 1, 2, 3)


def cases() -> list[Case]:
    """Return every case of this family."""
    parameters = [(name, None) for name in NAMES] + [("means", 3), ("colors", 3)]
    return [
        *(
            Case(FAMILY, f"finite differences of {name}, degree {degree}", Close(), _differences(name, degree))
            for name, degree in parameters
        ),
        Case(FAMILY, f"{RANDOM_SCENES} random scenes", Close(), _random_scenes),
    ]


def _differences(name: str, degree: int | None) -> Callable[[str], Observed]:
    """Compare with central differences of the float64 reference in every element of one parameter."""

    def run(backend: str) -> Observed:
        scene = cloud(4, seed=30, width=9, height=7, degree=degree)
        scene.scales = scene.scales * 3
        weights = torch.randn(7, 9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        constants = load_backend(backend).constants() or WITHOUT_THRESHOLDS
        smooth = replace(constants, min_alpha=1e-9, min_transmittance=0.0)
        double: Cloud = replace(scene, **{n: getattr(scene, n).double() for n in NAMES})
        at = getattr(double, name)
        slope = torch.zeros_like(at)
        for i in range(at.numel()):
            ends = []
            for sign in (1, -1):
                values = at.clone()
                values.view(-1)[i] += sign * STEP
                image = render(replace(double, **{name: values}), "reference", None, smooth).image
                ends.append((image * weights).sum().item())
            slope.view(-1)[i] = (ends[0] - ends[1]) / (2 * STEP)
        exact = render(scene, "reference", weights, smooth).gradients[name]
        got = render(scene, backend, weights, constants).gradients[name]
        worst = max(((found - slope).norm() / slope.norm()).item() for found in (exact, got))
        return Observed(f"{at.numel()} elements", {"image": 0.0, "gradients": worst})

    return run


def random_scenes() -> Iterator[Cloud]:
    """Yield random clouds in images of random size; the first is the smallest, the second the largest."""
    rng = np.random.default_rng(0)
    for number in range(RANDOM_SCENES):
        drawn = [int(rng.integers(low, high, endpoint=True)) for low, high in zip(SMALLEST, LARGEST, strict=True)]
        count, width, height = {0: SMALLEST, 1: LARGEST}.get(number, drawn)
        scene = cloud(count, number, width, height, DEGREES[number % len(DEGREES)])
        scene.scales = scene.scales * math.exp(rng.uniform(-8.0, 2.0))
        yield scene


def _random_scenes(backend: str) -> Observed:
    """Return the worst error over random scenes; NaN if any is."""
    worst = {"image": 0.0, "gradients": 0.0}
    for number, scene in enumerate(random_scenes()):
        errors = compared(scene, backend, number).numbers
        worst = {n: math.nan if math.isnan(errors[n] + old) else max(errors[n], old) for n, old in worst.items()}
    return Observed("the worst", worst)

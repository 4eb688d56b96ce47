"""Stress: the reference's gradients against finite differences, and a backend's against those; random scenes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tdgbench.experiments.measure.clouds import Cloud
from tdgbench.experiments.stress.case import Case, Close
from tdgbench.experiments.stress.compare import NAMES, cloud, compared, render
from tdgbench.experiments.stress.outcome import Seen
from tdgbench.splats.blending import AS_3DGS, Blending

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


def _differences(name: str, degree: int | None) -> Callable[[str], Seen]:
    """Central differences of the float64 reference in every element of one parameter."""

    def run(backend: str) -> Seen:
        scene = cloud(4, seed=30, width=9, height=7, degree=degree)
        scene.scales = scene.scales * 3
        weights = torch.randn(7, 9, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        constants = AS_3DGS if backend == "cuda" else WITHOUT_THRESHOLDS
        own = replace(constants, min_alpha=1e-9, min_transmittance=0.0)

        def total(changed: Cloud) -> float:
            return (render(changed, "reference", None, own)[0] * weights).sum().item()

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
        exact = render(scene, "reference", weights, own)[1][name]
        got = render(scene, backend, weights, constants)[1][name]
        size = slope.norm()
        worst = max(((exact - slope).norm() / size).item(), ((got - slope).norm() / size).item())
        return Seen(f"{at.numel()} elements", {"image": 0.0, "gradients": worst})

    return run


def _random_scenes(backend: str) -> Seen:
    """Scenes that hypothesis draws, small ones first; the worst of all."""
    worst = {"image": 0.0, "gradients": 0.0}

    @settings(
        max_examples=RANDOM_SCENES, deadline=None, derandomize=True, database=None,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(
        count=st.integers(1, 60),
        seed=st.integers(0, 2**20),
        width=st.integers(1, 50),
        height=st.integers(1, 40),
        log_scale=st.floats(-8, 2),
        degree=st.sampled_from([None, 0, 1, 2, 3]),
    )
    def draw(count: int, seed: int, width: int, height: int, log_scale: float, degree: int | None) -> None:
        scene = cloud(count, seed, width, height, degree)
        scene.scales = scene.scales * torch.tensor(log_scale).exp()
        for name, value in compared(scene, backend, seed).numbers.items():
            if name in worst and not value <= worst[name]:
                worst[name] = value

    draw()
    return Seen("the worst", worst)

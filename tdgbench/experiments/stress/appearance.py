"""Stress: opacities, colours and spherical harmonics."""

from __future__ import annotations

from collections.abc import Callable

import torch

from tdgbench.experiments.error_time.clouds import Cloud
from tdgbench.experiments.stress.case import Case, Close
from tdgbench.experiments.stress.compare import cloud, compared
from tdgbench.experiments.stress.outcome import Observed

FAMILY = "appearance"


def cases() -> list[Case]:
    """Every case of this family."""
    made: list[tuple[str, Callable[[], Cloud]]] = [
        ("opacity 0", lambda: _opacity(0.0)),
        ("opacity below 1/255", lambda: _opacity(0.0039)),
        ("opacity just above 1/255", lambda: _opacity(0.00393)),
        ("opacity 1 − 1e-7", lambda: _opacity(1 - 1e-7)),
        ("opacity 1", lambda: _opacity(1.0)),
        ("opacities from 0 to 1 in one scene", _ramp),
        ("harmonics of 1e4", lambda: _harmonics(1e4, 3)),
        ("harmonics of 1e-20", lambda: _harmonics(1e-20, 3)),
        ("harmonics that are negative everywhere", _dark),
        ("negative colours", lambda: _colors(-5.0)),
        ("colours of 1e8", lambda: _colors(1e8)),
        ("three channels and depth", _three),
        ("saturated alpha, layer on layer", _opaque_layers),
        ("transmittance underflow", _underflow),
        ("faint haze of a thousand", _haze),
    ]
    return [Case(FAMILY, name, Close(), _compare(make)) for name, make in made]


def _compare(make: Callable[[], Cloud]) -> Callable[[str], Observed]:
    return lambda backend: compared(make(), backend)


def _opacity(value: float) -> Cloud:
    scene = cloud(60, seed=20)
    scene.opacities = torch.full((60,), value)
    return scene


def _ramp() -> Cloud:
    scene = cloud(60, seed=21)
    scene.opacities = torch.linspace(0, 1, 60)
    return scene


def _harmonics(size: float, degree: int) -> Cloud:
    scene = cloud(60, seed=22, degree=degree)
    scene.colors = scene.colors * size
    return scene


def _dark() -> Cloud:
    scene = cloud(60, seed=23, degree=1)
    scene.colors = -scene.colors.abs() - 3
    return scene


def _colors(value: float) -> Cloud:
    scene = cloud(60, seed=24)
    scene.colors = scene.colors * value
    return scene


def _three() -> Cloud:
    scene = cloud(60, seed=25)
    scene.colors = torch.rand(60, 3, generator=torch.Generator().manual_seed(25))
    return scene


def _opaque_layers() -> Cloud:
    scene = cloud(60, seed=26)
    scene.opacities = torch.ones(60)
    scene.scales = scene.scales * 5
    return scene


def _underflow() -> Cloud:
    """300 layers of alpha 0.99, whose transmittance is 1e-600."""
    scene = cloud(300, seed=27, width=8, height=8)
    scene.viewmat = torch.eye(4)
    scene.means = torch.zeros(300, 3)
    scene.means[:, 2] = torch.linspace(1, 5, 300)
    scene.scales = torch.full((300, 3), 50.0)
    scene.opacities = torch.ones(300)
    return scene


def _haze() -> Cloud:
    scene = cloud(1000, seed=28, width=16, height=12)
    scene.opacities = torch.full((1000,), 0.006)
    scene.scales = scene.scales * 10
    return scene

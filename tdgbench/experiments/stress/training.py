"""Stress: degenerate scenes, extreme budgets, faults during training, and a failing cell in a sweep."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from omegaconf import DictConfig
from rich.console import Console

from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.experiments.stress.case import Case, Expected, Holds, Raises
from tdgbench.experiments.stress.fault import FAULTY_STEP, Fault, NanInGradient, NanInParameter, NanInTarget
from tdgbench.experiments.stress.outcome import Observed, require
from tdgbench.experiments.stress.scenes import shifted, with_cameras_on_a_line, with_points
from tdgbench.experiments.stress.small import Change, SmallTraining
from tdgbench.training.loop import TrainingLog
from tdgbench.training.method import Method

FAMILY = "training"
CAP = 350  # Gaussians
ONE_PLACE = Raises("SceneError", "stand in one place")
NO_POINTS = Raises("SceneError", "no sparse points; use init=random")
FINITE = Holds("every loss and parameter stays finite")


def cases(small: SmallTraining) -> list[Case]:
    """Every case of this family."""

    def finite(train: Callable[[str], tuple[Method, TrainingLog]]) -> Callable[[str], Observed]:
        return lambda backend: _check_finite(*train(backend))

    def on(change: Change) -> Callable[[str], Observed]:
        return finite(lambda backend: small.train(backend, change))

    def under(budget: dict[str, Any]) -> Callable[[str], Observed]:
        return finite(lambda backend: small.train(backend, budget=budget))

    def having(fault: Fault) -> Callable[[str], Observed]:
        return finite(lambda backend: small.train(backend, fault=fault))

    return [
        *(Case(FAMILY, name, expected, on(change)) for name, expected, change in _scenes()),
        *(Case(FAMILY, name, expected, under(budget)) for name, expected, budget in _budgets(small.cfg)),
        Case(FAMILY, "a cap on Gaussians reached", Holds("it is reached and kept"), lambda b: _capped(small, b)),
        *(
            Case(FAMILY, f"{name}, at step {FAULTY_STEP}", _names(tensor), having(fault))
            for name, tensor, fault in _faults()
        ),
        Case(
            FAMILY, "a failing cell in a sweep", Holds("its record names step and tensor; the next cell runs"),
            lambda b: _failing_cell(small, b),
        ),
    ]  # fmt: skip


def _scenes() -> list[tuple[str, Expected, Change]]:
    line = np.linspace(-1, 1, 50)[:, None] * np.array([[1.0, 0, 0]])
    return [
        ("one training view", ONE_PLACE, lambda s: replace(s, train=s.train[:1])),
        ("two training views", FINITE, lambda s: replace(s, train=s.train[:2])),
        ("identical cameras", ONE_PLACE, lambda s: with_cameras_on_a_line(s, lambda i: 0.0)),
        ("collinear cameras", FINITE, lambda s: with_cameras_on_a_line(s, lambda i: 0.2 * i)),
        ("no COLMAP points", NO_POINTS, lambda s: replace(s, points=None)),
        ("an empty point cloud", NO_POINTS, lambda s: with_points(s, np.zeros((0, 3)))),
        ("a single point", FINITE, lambda s: with_points(s, np.zeros((1, 3)))),
        ("collinear points", FINITE, lambda s: with_points(s, line)),
        ("duplicate points", FINITE, lambda s: with_points(s, np.zeros((50, 3)))),
        (
            "a point that is not finite", Raises("ValueError", "1 points of the cloud"),
            lambda s: with_points(s, np.full((1, 3), np.nan)),
        ),
        ("a scene 1e6 from the origin (UTM)", Raises("SceneError", "subtract"), lambda s: shifted(s, 1e6)),
    ]  # fmt: skip


def _budgets(cfg: DictConfig) -> list[tuple[str, Expected, dict[str, Any]]]:
    return [
        ("every Gaussian pruned", Raises("EmptyModelError", "no Gaussian is left"), {"density.min_opacity": 0.9999}),
        ("learning rates × 100", FINITE, _rates(cfg, 100)),
        ("learning rates 0", FINITE, _rates(cfg, 0)),
        ("SH degree 3 from the start", FINITE, {"sh_degree": 3, "sh_every": 1}),
        (
            "1 000 opacity resets", FINITE,
            {"iterations": 1000, "density.opacity_reset_every": 1, "density.stop": 1001, "density.every": 100_000},
        ),
        (
            "density control at every step", FINITE,
            {"density.start": 0, "density.every": 1, "density.max_gaussians": 2000},
        ),
    ]  # fmt: skip


def _rates(cfg: DictConfig, factor: float) -> dict[str, Any]:
    """Learning rates of the budget times a factor; a rate has to be positive."""
    rates = {k: v for k, v in cfg.budget.rates.items() if k not in ("_target_", "position_steps")}
    return {f"rates.{name}": max(float(value) * factor, 1e-30) for name, value in rates.items()}


def _faults() -> list[tuple[str, str, Fault]]:
    """Name, tensor that the error must name, fault."""
    return [
        ("NaN in the means", "thermal means", NanInParameter("means")),
        ("NaN in the scales", "thermal log_scales", NanInParameter("log_scales")),
        ("NaN in the quaternions", "thermal quats", NanInParameter("quats")),
        ("NaN in the opacities", "thermal opacity_logits", NanInParameter("opacity_logits")),
        ("NaN in the harmonics", "thermal sh", NanInParameter("sh")),
        ("NaN in a training image", "target image", NanInTarget()),
        ("NaN in the gradient of the image", "gradient of thermal", NanInGradient()),
    ]


def _names(tensor: str) -> Raises:
    return Raises("NonFiniteError", f"^{tensor}.* at iteration {FAULTY_STEP}$")


def _check_finite(method: Method, log: TrainingLog) -> Observed:
    for name, model in method.models().items():
        for parameter, tensor in model.gaussians.items():
            require(bool(torch.isfinite(tensor).all()), f"{name} {parameter} is not finite")
    counts = ", ".join(f"{len(model)} {name}" for name, model in method.models().items())
    return Observed(f"loss {log.lines[0].loss:.3g} to {log.lines[-1].loss:.3g}, {counts} Gaussians")


def _capped(small: SmallTraining, backend: str) -> Observed:
    density = {"start": 0, "every": 5, "grad_threshold": 0.0, "max_gaussians": CAP}
    method, _ = small.train(backend, budget={f"density.{name}": value for name, value in density.items()})
    (count,) = (len(model) for model in method.models().values())
    require(count == CAP, f"{count} Gaussians, the cap is {CAP}")
    return Observed(f"{count} Gaussians")


def _failing_cell(small: SmallTraining, backend: str) -> Observed:
    """Run a cell whose method has a fault, then a sound one."""
    sound = small.cfg.copy()
    sound.results, sound.name, sound.overwrite = str(small.folder / backend), "sweep", "always"
    sound.backend.name = backend
    faulty = sound.copy()
    sound.seed = int(sound.seed) + 1
    fault = {"_target_": f"{NanInParameter.__module__}.NanInParameter", "name": "means"}
    faulty.method.method = {
        "_target_": f"{NanInParameter.__module__}.FaultyMethod", "method": faulty.method.method, "fault": fault
    }  # fmt: skip
    quiet = CellProgress(Console(quiet=True), 1)
    first = run_cell(faulty, "", quiet)
    (record,) = read_all(small.folder / backend / "sweep")
    second = run_cell(sound, "", quiet)
    require(
        (first.status, second.status) == ("failed", "ok"), f"{first.status}, then {second.status}: {second.message}"
    )
    failure = record.failure
    if failure is None:
        raise ValueError("the record of the failed cell has no failure")
    require(failure.stage == "train", f"failed at stage {failure.stage}")
    require(failure.iteration == FAULTY_STEP, f"failed at iteration {failure.iteration}")
    require(failure.tensor == "thermal means", f"the record names {failure.tensor}")
    return Observed(f"{failure.error}; then {second.status}")

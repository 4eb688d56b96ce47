"""Stress: degenerate scenes, extreme budgets, faults during training, a failing cell in a sweep, equal bytes."""

from __future__ import annotations

import hashlib
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
from tdgbench.experiments.stress.case import Case, Expected, Observed, Raises, require
from tdgbench.experiments.stress.small import (
    FAULTY_STEP,
    FaultyMethod,
    SmallTraining,
    shifted,
    with_cameras_on_a_line,
    with_points,
)
from tdgbench.scenes import Camera, Scene
from tdgbench.splats.cpu import pool
from tdgbench.training.loop import TrainingLog
from tdgbench.training.method import Frame
from tdgbench.training.trainer import Trainer

FAMILY = "training"
CAP = 350  # Gaussians
ONE_PLACE = Raises("SceneError", "stand in one place")
NO_POINTS = Raises("SceneError", "no sparse points; use init=random")
FINITE = "every loss and parameter stays finite"
REPETITIONS = 5
FAULTS = (  # where, the tensor that the error must name, the fault
    ("the means", "thermal means", "means"),
    ("the scales", "thermal log_scales", "log_scales"),
    ("the quaternions", "thermal quats", "quats"),
    ("the opacities", "thermal opacity_logits", "opacity_logits"),
    ("the harmonics", "thermal sh", "sh"),
    ("a training image", "target image", "target"),
    ("the gradient of the image", "gradient of thermal", "gradient"),
)


def cases(small: SmallTraining) -> list[Case]:
    """Return every case of the families `training` and `determinism`."""

    def finite(**given: Any) -> Callable[[str], Observed]:
        return lambda backend: _check_finite(*small.train(backend, **given))

    return [
        *(Case(FAMILY, name, expected, finite(change=change)) for name, expected, change in _scenes()),
        *(Case(FAMILY, name, expected, finite(budget=budget)) for name, expected, budget in _budgets(small.cfg)),
        Case(FAMILY, "a cap on Gaussians reached", "it is reached and kept", lambda b: _capped(small, b)),
        *(
            Case(
                FAMILY, f"NaN in {name}, at step {FAULTY_STEP}",
                Raises("NonFiniteError", f"^{tensor}.* at iteration {FAULTY_STEP}$"), finite(fault=fault),
            )
            for name, tensor, fault in FAULTS
        ),
        Case(
            FAMILY, "a failing cell in a sweep", "its record names step and tensor; the next cell runs",
            lambda b: _failing_cell(small, b),
        ),
        Case(
            "determinism", "a training, five times", "the same bytes on the CPU; on a GPU the spread is told",
            lambda b: repeated(lambda: small.train(b)[0], small.scene().train[0].camera, b),
        ),
        Case(
            "determinism", "a training on 1, 2 and 3 threads", "the same bytes",
            lambda _: _on_threads(lambda: small.train("cpu")[0], [1, 2, 3]), every_backend=False,
        ),
        Case("determinism", "another seed", "other bytes", lambda b: _with_another_seed(small, b)),
    ]  # fmt: skip


def _scenes() -> list[tuple[str, Expected, Callable[[Scene], Scene]]]:
    line = np.linspace(-1, 1, 50)[:, None] * np.array([[1.0, 0, 0]])
    return [
        ("one training view", ONE_PLACE, lambda s: replace(s, train=s.train[:1])),
        ("two training views", FINITE, lambda s: replace(s, train=s.train[:2])),
        ("identical cameras", ONE_PLACE, lambda s: with_cameras_on_a_line(s, 0.0)),
        ("collinear cameras", FINITE, lambda s: with_cameras_on_a_line(s, 0.2)),
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
    """Return the learning rates of the budget times a factor; a rate has to be positive."""
    rates = {k: v for k, v in cfg.budget.rates.items() if k not in ("_target_", "position_steps")}
    return {f"rates.{name}": max(float(value) * factor, 1e-30) for name, value in rates.items()}


def _check_finite(trainer: Trainer, log: TrainingLog) -> Observed:
    for name, model in trainer.gaussians.items():
        for parameter, tensor in model.gaussians.items():
            require(bool(torch.isfinite(tensor).all()), f"{name} {parameter} is not finite")
    counts = ", ".join(f"{len(model)} {name}" for name, model in trainer.gaussians.items())
    return Observed(f"loss {log.lines[0].loss:.3g} to {log.lines[-1].loss:.3g}, {counts} Gaussians")


def _capped(small: SmallTraining, backend: str) -> Observed:
    density = {"start": 0, "every": 5, "grad_threshold": 0.0, "max_gaussians": CAP}
    trainer, _ = small.train(backend, budget={f"density.{name}": value for name, value in density.items()})
    (count,) = (len(model) for model in trainer.gaussians.values())
    require(count == CAP, f"{count} Gaussians, the cap is {CAP}")
    return Observed(f"{count} Gaussians")


def _failing_cell(small: SmallTraining, backend: str) -> Observed:
    """Run a cell whose method has a fault, then a sound one."""
    sound = small.cfg.copy()
    sound.results, sound.name, sound.overwrite = str(small.folder / backend), "sweep", "always"
    sound.backend.name = backend
    faulty = sound.copy()
    sound.seed = int(sound.seed) + 1
    target = f"{FaultyMethod.__module__}.{FaultyMethod.__name__}"
    faulty.method.method = {"_target_": target, "method": faulty.method.method, "fault": "means"}
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


def repeated(train: Callable[[], Trainer], camera: Camera, backend: str) -> Observed:
    """Train five times. On the CPU all bytes must agree; elsewhere sums have no fixed order, and the spread of the
    render from a camera is measured."""
    trainers = [train() for _ in range(REPETITIONS)]
    if backend == "cpu":
        digests = {_digest(trainer) for trainer in trainers}
        require(len(digests) == 1, f"{len(digests)} different results")
        return Observed(f"{REPETITIONS} times {digests.pop()}")
    counts = [sum(len(model) for model in trainer.gaussians.values()) for trainer in trainers]
    images = torch.stack([trainer.method.render(Frame(camera)).cpu().image for trainer in trainers])
    return Observed(f"{min(counts)} to {max(counts)} Gaussians", {"spread of a training view": spread(images)})


def spread(images: torch.Tensor) -> float:
    """Return the largest standard deviation of any value over the first axis; images (N, H, W, C)."""
    return float(images.std(dim=0).max())


def _digest(trainer: Trainer) -> str:
    """Return a hash of all parameters of the Gaussians."""
    digest = hashlib.sha256()
    for model in trainer.gaussians.values():
        for _, tensor in model.gaussians.items():
            digest.update(tensor.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:12]


def _on_threads(train: Callable[[], Trainer], threads: list[int]) -> Observed:
    before = pool.get_threads()
    try:
        digests = []
        for count in threads:
            pool.set_threads(count)
            digests.append(_digest(train()))
    finally:
        pool.set_threads(before)
    require(len(set(digests)) == 1, f"{digests} with {threads} threads")
    return Observed(f"{len(digests)} times {digests[0]}")


def _with_another_seed(small: SmallTraining, backend: str) -> Observed:
    cfg = small.cfg.copy()
    cfg.seed = int(cfg.seed) + 1
    other = SmallTraining(cfg, small.folder)
    digests = [_digest(training.train(backend)[0]) for training in (small, other)]
    require(digests[0] != digests[1], f"both {digests[0]}")
    return Observed(" and ".join(digests))

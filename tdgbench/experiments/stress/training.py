"""Stress: degenerate scenes, extreme budgets, faults during training, equal bytes; all in small trainings."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.setup import set_up
from tdgbench.experiments.stress.case import Case, Raises, require
from tdgbench.scenes import PointCloud, Scene
from tdgbench.splats.cpu import pool
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Step
from tdgbench.training.part import Network
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.trainer import Trainer

_FAMILY = "training"
CAP = 350  # Gaussians
ONE_PLACE = Raises("SceneError", "stand in one place")
NO_POINTS = Raises("SceneError", "no sparse points; use init=random")
FINITE = "every loss and parameter stays finite"
THREADS = (1, 1, 2, 2, 3)  # of trainings that must end with the same bytes
FAULTY_STEP = 7
FAULTS = (  # where, the tensor that the error must name, the fault
    ("the means", "thermal means", "means"),
    ("the scales", "thermal log_scales", "log_scales"),
    ("the quaternions", "thermal quats", "quats"),
    ("the opacities", "thermal opacity_logits", "opacity_logits"),
    ("the harmonics", "thermal sh", "sh"),
    ("a training image", "target image", "target"),
    ("the gradient of the image", "gradient of thermal", "gradient"),
)


def cases(cfg: DictConfig) -> list[Case]:
    """Return every case of the families `training` and `determinism`. cfg: of a small training."""

    def finite(**given: Any) -> Callable[[str], str]:
        return lambda backend: check_finite(*train_small(cfg, backend, **given))

    return [
        *(Case(_FAMILY, name, expected, finite(change=change)) for name, expected, change in scenes()),
        *(Case(_FAMILY, name, expected, finite(budget=budget)) for name, expected, budget in _budgets(cfg)),
        Case(_FAMILY, "a cap on Gaussians reached", "it is reached and kept", lambda b: _capped(cfg, b)),
        *(
            Case(
                _FAMILY, f"NaN in {name}, at step {FAULTY_STEP}",
                Raises("NonFiniteError", f"^{tensor}.* at iteration {FAULTY_STEP}$"), finite(fault=fault),
            )
            for name, tensor, fault in FAULTS
        ),
        Case(
            "determinism", "five trainings, on 1, 2 and 3 threads", "the same bytes",
            lambda _: check_same_bytes(lambda: train_small(cfg, "cpu")[0]), every_backend=False,
        ),
    ]  # fmt: skip


def train_small(
    cfg: DictConfig,
    backend: str,
    change: Callable[[Scene], Scene] = lambda scene: scene,
    budget: Mapping[str, Any] | None = None,
    fault: str | None = None,
) -> tuple[Trainer, TrainingLog]:
    """Train the configured method on a changed scene. budget: options by dotted name. fault: see `break_step`."""
    cfg = cfg.copy()
    cfg.backend.name = backend
    for name, value in (budget or {}).items():
        OmegaConf.update(cfg.budget, name, value)
    trainer = set_up(cfg, change(instantiate(cfg.dataset.loader).load(cfg.scene)), compiles=False).trainer
    if fault is not None:
        break_step(trainer, fault)
    return trainer, train(trainer)


def with_method(cfg: DictConfig, method: DictConfig) -> DictConfig:
    """Return a configuration with another method."""
    changed = cfg.copy()
    changed.method = method
    return changed


def break_step(trainer: Trainer, fault: str) -> None:
    """Put NaN into a training at FAULTY_STEP.

    fault: a parameter of the thermal model's Gaussians (NaN in all of them, so that some are visible), `network`
    (all parameters of networks), `target` (in one pixel of every training image), or `gradient` (in the gradient of the
    rendered image; the loss stays finite).
    """
    stage = trainer.stage

    def faulty(iteration: int) -> Step:
        if iteration != FAULTY_STEP:
            return stage.step(iteration)
        if fault == "target":
            for view in trainer.context.scene.train:
                view.thermal = view.thermal.copy()
                view.thermal[1, 2] = np.nan
        elif fault == "network":
            for network in (part for part in trainer.parts.values() if isinstance(part, Network)):
                for parameter in network.module.parameters():
                    parameter.detach().fill_(float("nan"))
        elif fault != "gradient":
            getattr(trainer.gaussians["thermal"].gaussians, fault).detach().fill_(float("nan"))
        step = stage.step(iteration)
        if fault == "gradient":
            step.render.image.register_hook(lambda grad: grad * float("nan"))
        return step

    trainer.stages[0] = stage._replace(step=faulty)


def with_points(scene: Scene, points: np.ndarray) -> Scene:
    """Return a scene with other points (N, 3), world units, all gray."""
    return replace(scene, points=PointCloud(points.astype(np.float64), np.full((len(points), 3), 0.5, np.float32)))


def with_cameras_on_a_line(scene: Scene, step: float) -> Scene:
    """Return a scene whose training cameras have the first one's rotation and stand on a line, `step` units apart."""
    along_x = np.zeros((4, 4))
    along_x[0, 3] = step
    return _with_poses(scene, lambda i, _: scene.train[0].camera.world_to_camera + i * along_x)


def turning(scene: Scene) -> Scene:
    """Return a scene whose training cameras stand where the first one does, and turn by 3° each about its y axis."""

    def turned(i: int, _: np.ndarray) -> np.ndarray:
        sin, cos = np.sin(np.radians(3) * i), np.cos(np.radians(3) * i)
        turn = np.array([[cos, 0, sin, 0], [0, 1, 0, 0], [-sin, 0, cos, 0], [0, 0, 0, 1]])
        return turn @ scene.train[0].camera.world_to_camera

    return _with_poses(scene, turned)


def scaled(scene: Scene, factor: float) -> Scene:
    """Return a scene, which has points, times a factor about the origin."""
    assert scene.points is not None
    of_shift = np.ones((4, 4))
    of_shift[:3, 3] = factor
    points = replace(scene.points, points=factor * scene.points.points)
    return replace(_with_poses(scene, lambda _, pose: of_shift * pose), points=points)


def shifted(scene: Scene, offset: float) -> Scene:
    """Return a scene, which has points, moved by an offset along each axis, world units."""
    assert scene.points is not None
    back = np.eye(4)
    back[:3, 3] = -offset
    points = replace(scene.points, points=scene.points.points + offset)
    return replace(_with_poses(scene, lambda _, pose: pose @ back), points=points)


def _with_poses(scene: Scene, change: Callable[[int, np.ndarray], np.ndarray]) -> Scene:
    """Return a scene with other training cameras. change: number and pose (4, 4), world to camera, to the new pose."""
    views = []
    for number, view in enumerate(scene.train):
        pose = change(number, view.camera.world_to_camera)
        views.append(replace(view, camera=replace(view.camera, world_to_camera=pose)))
    return replace(scene, train=views)


def scenes() -> list[tuple[str, Raises | str, Callable[[Scene], Scene]]]:
    """Return degenerate scenes: name, what is expected of Gaussians, and how a scene becomes it."""
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


def _budgets(cfg: DictConfig) -> list[tuple[str, Raises | str, dict[str, Any]]]:
    return [
        ("every Gaussian pruned", Raises("EmptyModelError", "no Gaussian is left"), {"density.min_opacity": 0.9999}),
        ("learning rates × 100", FINITE, _rates(cfg, 100)),
        ("learning rates 0", FINITE, _rates(cfg, 0)),
        ("SH degree 3 from the start", FINITE, {"sh_degree": 3, "sh_every": 1}),
        (
            "300 opacity resets", FINITE,
            {
                "iterations": 301, "density.opacity_reset_every": 1, "density.stop": 302, "density.every": 100_000,
                "density.reset_recovery": 0,
            },
        ),
        (
            "density control at every step", FINITE,
            {"density.start": 0, "density.every": 1, "density.max_gaussians": 2000},
        ),
    ]  # fmt: skip


def _rates(cfg: DictConfig, factor: float) -> dict[str, Any]:
    """Return the learning rates of the budget times a factor; a rate has to be positive."""
    rates = {k: v for k, v in cfg.budget.rates.items() if k not in ("_target_", "means_steps")}
    return {f"rates.{name}": max(float(value) * factor, 1e-30) for name, value in rates.items()}


def check_finite(trainer: Trainer, log: TrainingLog) -> str:
    """Return the first and last loss, and sizes.

    Raises UnexpectedError if a part, or the render of a test view, is not finite.
    """
    sizes = []
    for name, part in trainer.all_parts().items():
        bad = part.not_finite()
        require(bad is None, f"{name} {bad} is not finite")
        if part.gaussian_count:
            sizes.append(f"{part.gaussian_count} {name} Gaussians")
    frame = trainer.context.frame(trainer.context.scene.test[0])
    require(bool(torch.isfinite(trainer.method.render(frame).image).all()), "a render is not finite")
    return ", ".join([f"loss {log.lines[0].loss:.3g} to {log.lines[-1].loss:.3g}", *sizes])


def _capped(cfg: DictConfig, backend: str) -> str:
    density = {"start": 0, "every": 5, "grad_threshold": 0.0, "max_gaussians": CAP}
    trainer, _ = train_small(cfg, backend, budget={f"density.{name}": value for name, value in density.items()})
    (count,) = (len(model) for model in trainer.gaussians.values())
    require(count == CAP, f"{count} Gaussians, the cap is {CAP}")
    return f"{count} Gaussians"


def check_same_bytes(train: Callable[[], Trainer]) -> str:
    """Train on the CPU with each number of threads in THREADS; the bytes of all parameters must agree."""
    before, digests = pool.get_threads(), []
    try:
        for count in THREADS:
            pool.set_threads(count)
            digest = hashlib.sha256()
            for tensor in _parameters(train()):
                digest.update(tensor.detach().contiguous().numpy().tobytes())
            digests.append(digest.hexdigest()[:12])
    finally:
        pool.set_threads(before)
    require(len(set(digests)) == 1, f"different results: {digests} with {THREADS} threads")
    return f"{len(digests)} times {digests[0]}"


def _parameters(trainer: Trainer) -> Iterator[torch.Tensor]:
    """Yield all parameters of Gaussians and networks."""
    for part in trainer.all_parts().values():
        if isinstance(part, SplatModel):
            yield from (tensor for _, tensor in part.gaussians.items())
        elif isinstance(part, Network):
            yield from part.module.parameters()

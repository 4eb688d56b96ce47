"""Stress: scenes, budgets and accidents of training; and that the same seed gives the same bytes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from tdgbench.bench.cell import run_cell
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import read_all
from tdgbench.bench.setup import set_up
from tdgbench.experiments.stress.case import Case, Expected, Holds, Raises
from tdgbench.experiments.stress.outcome import Seen
from tdgbench.scenes import PointCloud, Scene, View
from tdgbench.splats.cpu import pool
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method
from tdgbench.training.model import SplatModel

FAMILY = "training"
INJECTED_AT = 7
ONE_PLACE = Raises("SceneError", "stand in one place")
NO_POINTS = Raises("SceneError", "no points; use init=random")
FINITE = Holds("every loss and parameter stays finite")

Change = Callable[[Scene], Scene]


@dataclass(frozen=True)
class Small:
    """Small trainings after the experiment's own configuration."""

    cfg: DictConfig
    folder: Path

    def scene(self) -> Scene:
        scene: Scene = instantiate(self.cfg.dataset.loader).load(self.cfg.scene)
        return scene

    def train(
        self, backend: str, change: Change = lambda scene: scene, spoil: Callable[[Method], None] | None = None,
        **budget: Any,
    ) -> tuple[Method, TrainingLog]:  # fmt: skip
        """Train the configured method on a changed scene; options of the budget are dotted, with __ for the dots."""
        cfg = OmegaConf.merge(self.cfg.budget, _nested(budget))
        scene = change(self.scene())
        made = instantiate(cfg)
        method = set_up(instantiate(self.cfg.method.method), self.cfg, scene, made, backend)
        if spoil is not None:
            spoil(method)
        return method, train(method, made.iterations)


def cases(cfg: DictConfig, folder: Path) -> list[Case]:
    """Every case of this family. `cfg` describes a small cell; `folder` is for what must be on disk."""
    small = Small(cfg, folder)
    scenes: list[tuple[str, Expected, Change]] = [
        ("one training view", ONE_PLACE, lambda s: replace(s, train=s.train[:1])),
        ("two training views", FINITE, lambda s: replace(s, train=s.train[:2])),
        ("identical cameras", ONE_PLACE, lambda s: _cameras(s, lambda i: 0.0)),
        ("collinear cameras", FINITE, lambda s: _cameras(s, lambda i: 0.2 * i)),
        ("no COLMAP points", NO_POINTS, lambda s: replace(s, points=None)),
        ("an empty point cloud", NO_POINTS, lambda s: _points(s, np.zeros((0, 3)))),
        ("a single point", FINITE, lambda s: _points(s, np.zeros((1, 3)))),
        ("collinear points", FINITE, lambda s: _points(s, np.linspace(-1, 1, 50)[:, None] * np.array([[1.0, 0, 0]]))),
        ("duplicate points", FINITE, lambda s: _points(s, np.zeros((50, 3)))),
        (
            "a point that is not finite", Raises("ValueError", "1 points of the cloud"),
            lambda s: _points(s, np.full((1, 3), np.nan)),
        ),
        ("a scene 1e6 from the origin (UTM)", Raises("SceneError", "subtract"), lambda s: _shifted(s, 1e6)),
    ]  # fmt: skip
    budgets: list[tuple[str, Expected, dict[str, Any]]] = [
        ("every Gaussian pruned", Raises("EmptyModelError", "no Gaussian is left"), {"density__min_opacity": 0.9999}),
        ("learning rates × 100", FINITE, _rates(cfg, 100)),
        ("learning rates 0", FINITE, _rates(cfg, 0)),
        ("SH degree 3 from the start", FINITE, {"sh_degree": 3, "sh_every": 1}),
        (
            "1 000 opacity resets", FINITE,
            {"iterations": 1000, "density__opacity_reset_every": 1, "density__stop": 1001, "density__every": 100_000},
        ),
        (
            "density control at every step", FINITE,
            {"density__start": 0, "density__every": 1, "density__max_gaussians": 2000},
        ),
    ]  # fmt: skip
    accidents: list[tuple[str, str, Callable[[Method], None]]] = [
        ("NaN in the means", "thermal means", _in_parameter("means")),
        ("NaN in the scales", "thermal log_scales", _in_parameter("log_scales")),
        ("NaN in the quaternions", "thermal quats", _in_parameter("quats")),
        ("NaN in the opacities", "thermal opacity_logits", _in_parameter("opacity_logits")),
        ("NaN in the harmonics", "thermal sh", _in_parameter("sh")),
        ("NaN in a training image", "target image", _in_target),
        ("NaN in the gradient of the image", "gradient of thermal", _in_gradient),
    ]

    def finite(run: Callable[[str], tuple[Method, TrainingLog]]) -> Callable[[str], Seen]:
        return lambda backend: _check_finite(*run(backend))

    def on(change: Change) -> Callable[[str], Seen]:
        return finite(lambda backend: small.train(backend, change))

    def under(budget: dict[str, Any]) -> Callable[[str], Seen]:
        return finite(lambda backend: small.train(backend, **budget))

    def spoiled(spoil: Callable[[Method], None]) -> Callable[[str], Seen]:
        return finite(lambda backend: small.train(backend, spoil=spoil))

    named = [
        (name, Raises("NonFiniteError", f"^{tensor}.* at iteration {INJECTED_AT}$"), spoil)
        for name, tensor, spoil in accidents
    ]
    return [
        *(Case(FAMILY, name, expected, on(change)) for name, expected, change in scenes),
        *(Case(FAMILY, name, expected, under(budget)) for name, expected, budget in budgets),
        Case(FAMILY, "a cap on Gaussians reached", Holds("it is reached and kept"), lambda b: _capped(small, b)),
        *(Case(FAMILY, f"{name}, at step {INJECTED_AT}", expected, spoiled(spoil)) for name, expected, spoil in named),
        Case(
            FAMILY, "a failing cell in a sweep", Holds("its record names step and tensor; the next cell runs"),
            lambda b: _failing_cell(small, b),
        ),
        Case(
            "determinism", "a training, five times", Holds("the same bytes on the CPU; on a GPU the spread is told"),
            lambda b: _repeated(lambda: small.train(b)[0], b),
        ),
        Case(
            "determinism", "a training on 1, 2 and 3 threads", Holds("the same bytes"),
            lambda b: _same_bytes(lambda: small.train("cpu")[0], [1, 2, 3]), every_backend=False,
        ),
        Case(
            "determinism", "another seed", Holds("other bytes"),
            lambda b: _other_bytes(small, b),
        ),
    ]  # fmt: skip


def _nested(options: dict[str, Any]) -> DictConfig:
    made = OmegaConf.create()
    for key, value in options.items():
        OmegaConf.update(made, key.replace("__", "."), value)
    return made


def _rates(cfg: DictConfig, factor: float) -> dict[str, Any]:
    rates = {k: v for k, v in cfg.budget.rates.items() if k not in ("_target_", "position_steps")}
    return {f"rates__{name}": max(float(value) * factor, 1e-30) for name, value in rates.items()}


def _points(scene: Scene, points: np.ndarray) -> Scene:
    return replace(scene, points=PointCloud(points.astype(np.float64), np.full((len(points), 3), 0.5, np.float32)))


def _cameras(scene: Scene, position: Callable[[int], float]) -> Scene:
    """The first view's image and rotation from places on a line."""
    first = scene.train[0]
    views = []
    for i, view in enumerate(scene.train):
        pose = first.camera.world_to_camera.copy()
        pose[0, 3] += position(i)
        views.append(_view(view, replace(first.camera, world_to_camera=pose)))
    return replace(scene, train=views)


def _shifted(scene: Scene, offset: float) -> Scene:
    views = []
    for view in scene.train:
        pose = view.camera.world_to_camera.copy()
        pose[:3, 3] -= pose[:3, :3] @ np.full(3, offset)
        views.append(_view(view, replace(view.camera, world_to_camera=pose)))
    assert scene.points is not None
    moved = replace(scene, train=views)
    return replace(moved, points=PointCloud(scene.points.points + offset, scene.points.colors))


def _view(view: View, camera: Any) -> View:
    return View(view.name, camera, view.load_thermal, view.load_rgb, view.thermal_path, view.true_depth_path)


def _check_finite(method: Method, log: TrainingLog) -> Seen:
    for name, model in method.models().items():
        for parameter, tensor in model.gaussians.items():
            assert bool(torch.isfinite(tensor).all()), f"{name} {parameter} is not finite"
    counts = ", ".join(f"{len(model)} {name}" for name, model in method.models().items())
    return Seen(f"loss {log.lines[0].loss:.3g} to {log.lines[-1].loss:.3g}, {counts} Gaussians")


def _capped(small: Small, backend: str) -> Seen:
    cap = 350
    method, _ = small.train(
        backend, density__start=0, density__every=5, density__grad_threshold=0.0, density__max_gaussians=cap
    )
    (count,) = (len(model) for model in method.models().values())
    assert count == cap, f"{count} Gaussians, the cap is {cap}"
    return Seen(f"{count} Gaussians")


def _at_step(method: Method, act: Callable[[], None]) -> None:
    """Make a method do something just before its step INJECTED_AT."""
    step = method.step

    def spoiled(iteration: int):
        if iteration == INJECTED_AT:
            act()
        return step(iteration)

    method.step = spoiled  # type: ignore[method-assign]


def _in_parameter(name: str) -> Callable[[Method], None]:
    def spoil(method: Method) -> None:
        model = method.models()["thermal"]

        def act() -> None:
            getattr(model.gaussians, name).detach().fill_(float("nan"))  # all of them, so that some are in sight

        _at_step(method, act)

    return spoil


def _in_target(method: Method) -> None:
    views: list[View] = method.views._views  # type: ignore[attr-defined]

    def act() -> None:
        for view in views:
            spoiled = view.thermal.copy()
            spoiled[1, 2] = np.nan
            view.__dict__["thermal"] = spoiled

    _at_step(method, act)


def _in_gradient(method: Method) -> None:
    """The loss is finite, its gradient is not."""
    step = method.step

    def spoiled(iteration: int):
        made = step(iteration)
        if iteration == INJECTED_AT:
            made.thermal.image.register_hook(lambda grad: grad * float("nan"))
        return made

    method.step = spoiled  # type: ignore[method-assign]


def _failing_cell(small: Small, backend: str) -> Seen:
    cfg = small.cfg.copy()
    cfg.results, cfg.name, cfg.overwrite, cfg.backend.name = str(small.folder / backend), "sweep", "always", backend
    quiet = CellProgress(Console(quiet=True), 1)
    original = SplatModel.finish

    def spoiled(model: SplatModel, iteration: int):
        if iteration == INJECTED_AT:
            model.gaussians.means[:] = float("nan")
        return original(model, iteration)

    with mock.patch.object(SplatModel, "finish", spoiled):
        first = run_cell(cfg, "", quiet)
    failed = read_all(small.folder / backend / "sweep")[0]
    cfg.seed = int(cfg.seed) + 1
    second = run_cell(cfg, "", quiet)
    assert (first.status, second.status) == ("failed", "ok"), f"{first.status}, then {second.status}: {second.message}"
    assert failed.failure is not None and failed.failure.stage == "train"
    assert failed.failure.iteration in (INJECTED_AT, INJECTED_AT + 1) and failed.failure.tensor == "thermal means"
    return Seen(f"{failed.failure.error}; then {second.status}")


def _repeated(make: Callable[[], Method], backend: str) -> Seen:
    """On the CPU the bytes of five trainings must agree; elsewhere sums have no fixed order, and the spread is told."""
    methods = [make() for _ in range(5)]
    if backend == "cpu":
        found = {_digest(method) for method in methods}
        assert len(found) == 1, f"{len(found)} different results"
        return Seen(f"5 times {found.pop()}")
    counts = [sum(len(model) for model in method.models().values()) for method in methods]
    camera = methods[0].views._views[0].camera  # type: ignore[attr-defined]
    images = torch.stack([method.render(camera).cpu().image for method in methods])
    return Seen(f"{min(counts)} to {max(counts)} Gaussians", {"spread of a training view": _spread(images)})


def _spread(images: torch.Tensor) -> float:
    """The largest standard deviation of any pixel over the first axis."""
    return float(images.std(dim=0).max())


def _digest(method: Method) -> str:
    digest = hashlib.sha256()
    for model in method.models().values():
        for _, tensor in model.gaussians.items():
            digest.update(tensor.cpu().contiguous().numpy().tobytes())
    return digest.hexdigest()[:12]


def _same_bytes(make: Callable[[], Method], threads: list[int | None]) -> Seen:
    before = pool.get_threads()
    try:
        found = []
        for count in threads:
            pool.set_threads(count)
            found.append(_digest(make()))
    finally:
        pool.set_threads(before)
    assert len(set(found)) == 1, f"{found} with {threads} threads"
    return Seen(f"{len(found)} times {found[0]}")


def _other_bytes(small: Small, backend: str) -> Seen:
    cfg = small.cfg.copy()
    cfg.seed = int(cfg.seed) + 1
    other = Small(cfg, small.folder)
    found = [_digest(one.train(backend)[0]) for one in (small, other)]
    assert found[0] != found[1], f"both {found[0]}"
    return Seen(" and ".join(found))

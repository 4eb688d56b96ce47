"""Small trainings for stress cases: the experiment's configuration, with faults, on degenerate scenes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.setup import set_up
from tdgbench.scenes import PointCloud, Scene
from tdgbench.splats.view import Render
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Context, Frame, Method, Step
from tdgbench.training.model import SplatModel
from tdgbench.training.trainer import Trainer

FAULTY_STEP = 7


class FaultyMethod(Method):
    """A method with NaN at FAULTY_STEP.

    fault: a parameter of the thermal model's Gaussians (NaN in all of them, so that some are visible), `target` (in one
    pixel of every training image), or `gradient` (in the gradient of the rendered image; the loss stays finite).
    """

    def __init__(self, method: Method, fault: str) -> None:
        self.name, self.modalities, self.needs_prior = method.name, method.modalities, method.needs_prior
        self._method, self._fault = method, fault

    def setup(self, context: Context) -> None:
        self._context = context
        self._method.setup(context)

    def step(self, iteration: int) -> Step:
        is_faulty = iteration == FAULTY_STEP
        if is_faulty and self._fault == "target":
            for view in self._context.scene.train:
                view.thermal = view.thermal.copy()
                view.thermal[1, 2] = np.nan
        elif is_faulty and self._fault != "gradient":
            thermal = self._context.parts["thermal"]
            assert isinstance(thermal, SplatModel)
            getattr(thermal.gaussians, self._fault).detach().fill_(float("nan"))
        step = self._method.step(iteration)
        if is_faulty and self._fault == "gradient":
            step.render.image.register_hook(lambda grad: grad * float("nan"))
        return step

    def render(self, frame: Frame, modality: str = "thermal") -> Render:
        return self._method.render(frame, modality)


@dataclass(frozen=True)
class SmallTraining:
    """A small training: the configured method on the configured scene. `folder` is for what must be on disk."""

    cfg: DictConfig
    folder: Path

    def scene(self) -> Scene:
        """Load the configured scene."""
        scene: Scene = instantiate(self.cfg.dataset.loader).load(self.cfg.scene)
        return scene

    def train(
        self,
        backend: str,
        change: Callable[[Scene], Scene] | None = None,
        budget: Mapping[str, Any] | None = None,
        fault: str | None = None,
    ) -> tuple[Trainer, TrainingLog]:
        """Train on a changed scene. budget: options by dotted name. fault: see `FaultyMethod`."""
        cfg, scene = self.cfg.copy(), self.scene()
        cfg.backend.name = backend
        for name, value in (budget or {}).items():
            OmegaConf.update(cfg.budget, name, value)
        method: Method = instantiate(cfg.method.method)
        if fault is not None:
            method = FaultyMethod(method, fault)
        trainer = set_up(cfg, scene if change is None else change(scene), method=method, compiles=False).trainer
        return trainer, train(trainer)


def with_points(scene: Scene, points: np.ndarray) -> Scene:
    """Return a scene with other points (N, 3), world units, all gray."""
    return replace(scene, points=PointCloud(points.astype(np.float64), np.full((len(points), 3), 0.5, np.float32)))


def with_cameras_on_a_line(scene: Scene, step: float) -> Scene:
    """Return a scene whose training cameras have the first one's rotation and stand on a line, `step` units apart."""
    first = scene.train[0].camera
    views = []
    for i, view in enumerate(scene.train):
        pose = first.world_to_camera.copy()
        pose[0, 3] += step * i
        views.append(replace(view, camera=replace(first, world_to_camera=pose)))
    return replace(scene, train=views)


def shifted(scene: Scene, offset: float) -> Scene:
    """Return a scene moved by an offset along each axis, world units. Raises ValueError if it has no points."""
    if scene.points is None:
        raise ValueError(f"scene {scene.name} has no points to shift")
    views = []
    for view in scene.train:
        pose = view.camera.world_to_camera.copy()
        pose[:3, 3] -= pose[:3, :3] @ np.full(3, offset)
        views.append(replace(view, camera=replace(view.camera, world_to_camera=pose)))
    return replace(scene, train=views, points=PointCloud(scene.points.points + offset, scene.points.colors))

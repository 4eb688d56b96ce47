"""Small trainings for stress cases, after the experiment's configuration."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.setup import set_up
from tdgbench.experiments.stress.fault import Fault, FaultyMethod
from tdgbench.scenes import Scene
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method

Change = Callable[[Scene], Scene]


def unchanged(scene: Scene) -> Scene:
    """The scene itself."""
    return scene


@dataclass(frozen=True)
class SmallTraining:
    """Trains the configured method on the configured scene. `folder` is for what must be on disk."""

    cfg: DictConfig
    folder: Path

    def scene(self) -> Scene:
        """Load the configured scene."""
        scene: Scene = instantiate(self.cfg.dataset.loader).load(self.cfg.scene)
        return scene

    def train(
        self,
        backend: str,
        change: Change = unchanged,
        budget: Mapping[str, Any] | None = None,
        fault: Fault | None = None,
    ) -> tuple[Method, TrainingLog]:
        """Train on a changed scene. budget: options by dotted name. fault: fault to inject at one step."""
        cfg = self.cfg.copy()
        cfg.backend.name = backend
        for name, value in (budget or {}).items():
            OmegaConf.update(cfg.budget, name, value)
        method: Method = instantiate(cfg.method.method)
        if fault is not None:
            method = FaultyMethod(method, fault)
        training = set_up(cfg, change(self.scene()), method=method, compiles=False)
        return method, train(method, training.context.budget.iterations)

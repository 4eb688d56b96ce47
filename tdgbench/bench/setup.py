"""From a configuration to a method that is ready to train, for what trains without being a cell."""

from __future__ import annotations

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.priors import estimate_all
from tdgbench.scenes import Scene
from tdgbench.training.budget import Budget
from tdgbench.training.method import Context, Method
from tdgbench.training.skips import Skips


def loader_of(cfg: DictConfig, skips: Skips) -> DictConfig:
    """The loader's configuration; without the skip `gray` every thermal image gets three channels."""
    loader = cfg.dataset.loader.copy()
    if not skips.gray.allowed and loader.options.channels == "auto":
        loader.options.channels = 3
    return loader


def set_up(
    method: Method, cfg: DictConfig, scene: Scene, budget: Budget, backend: str, skips: Skips | None = None
) -> Method:
    """Read the training images, estimate priors afresh, and make the method's models at the configured points."""
    for view in scene.train:
        _ = view.thermal, view.rgb if method.needs_rgb else None
    priors = estimate_all(instantiate(cfg.prior.estimator), scene, None)[0] if method.needs_prior else {}
    points = instantiate(cfg.init.points).points(scene)
    method.setup(Context(scene, points, priors, budget, backend, int(cfg.seed), skips or Skips()))
    return method

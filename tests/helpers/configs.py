"""The project's configuration, and overrides that make its parts small."""

from __future__ import annotations

import copy
from functools import cache

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig

from tests.helpers.paths import ROOT

SMALL = (
    "dataset.loader.width=48",
    "dataset.loader.height=36",
    "dataset.loader.views=10",
    "dataset.loader.points=300",
    "metrics.lpips.download=false",
)
QUICK = (*SMALL, "budget=demo", "budget.iterations=12", "prior=synthetic")


def config(*overrides: str) -> DictConfig:
    """The project's configuration, composed with overrides."""
    return copy.deepcopy(_composed(overrides))


@cache
def _composed(overrides: tuple[str, ...]) -> DictConfig:
    """Composed once per set of overrides: a quarter of a second each."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("config", overrides=list(overrides))

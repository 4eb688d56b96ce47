"""The project's configuration, and overrides that make its parts small."""

from __future__ import annotations

import copy
from functools import cache

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig, OmegaConf

from tests.helpers.paths import ROOT

SMALL = (
    "dataset.loader.width=48",
    "dataset.loader.height=36",
    "dataset.loader.views=10",
    "dataset.loader.points=300",
    "metrics.lpips.download=false",
)
QUICK = (*SMALL, "budget=demo", "budget.iterations=12", "prior=synthetic")


FOLDERS = ("data.root", "results")


def config(*overrides: str) -> DictConfig:
    """The project's configuration, composed with overrides; folders, which differ in each test, are set afterwards."""
    composed = copy.deepcopy(_composed(tuple(word for word in overrides if word.split("=")[0] not in FOLDERS)))
    for option, _, value in (word.partition("=") for word in overrides if word.split("=")[0] in FOLDERS):
        OmegaConf.update(composed, option, value)
    return composed


@cache
def _composed(overrides: tuple[str, ...]) -> DictConfig:
    """Composed once per set of overrides: a quarter of a second each."""
    GlobalHydra.instance().clear()
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        return compose("config", overrides=list(overrides))

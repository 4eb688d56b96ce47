"""Before a sweep: write its plan, and name missing scenes and priors before hours of work begin."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.plan import IN_THE_PATH, Plan, configs_by, swept
from tdgbench.experiments.preparation import unavailable_priors
from tdgbench.scenes import SceneError
from tdgbench.terminal import say


class CellCount(NamedTuple):
    """Number of cells of a sweep."""

    total: int
    without_data: int  # their scene is not on disk


def plan_sweep(cfg: DictConfig) -> CellCount:
    """Write the plan of a sweep; print one error for all missing scenes, and one for each missing prior.

    Raises SystemExit(1) for an unknown scene.
    """
    dataset = instantiate(cfg.dataset.loader)
    options = swept(cfg)
    try:
        scenes = [dataset.describe(name) for name in options.get("scene") or [cfg.scene]]
        missing = dataset.missing([one.scene for one in scenes])
    except SceneError as error:
        say(str(error), "error:", stderr=True)
        raise SystemExit(1) from error
    if missing:
        say(dataset.explain_missing(missing), "error:", stderr=True)
    for message in unavailable_priors(configs_by(cfg, ("method", "dataset", "prior"))):
        say(f"{message}\n  cells of methods without a prior run", "error:", stderr=True)
    plan = Plan(
        table=cfg.table,
        scenes=scenes,
        methods=options.get("method", [cfg.method.name]),
        inits=options.get("init", [cfg.init.name]),
        variant_keys=[key for key in options if key not in IN_THE_PATH],
    )
    plan.write(Path(cfg.results) / cfg.name)  # for the tables
    plan.write(Path(cfg.hydra.sweep.dir))  # for the jobs: another sweep may replace the other one meanwhile
    per_scene = math.prod(len(values) or 1 for key, values in options.items() if key != "scene")
    return CellCount(per_scene * len(scenes), per_scene * len(missing))

"""Before a sweep: write its plan, count its cells, and name missing scenes and priors before hours of work begin."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.plan import IN_THE_PATH, Plan, configs_by, key_and_value, number_of_jobs, overrides_of_jobs, swept
from tdgbench.bench.record import Record
from tdgbench.bench.stored import readable_record
from tdgbench.experiments.preparation import unavailable_priors
from tdgbench.experiments.sweep.cells import PlannedCell, State, count_by_state, write_cells
from tdgbench.scenes import Description, SceneError
from tdgbench.terminal import say

WITHIN_A_KIND = ("scene", "seed", "dataset", "name", "results")  # options in which cells of a kind may differ


class CellCount(NamedTuple):
    """Number of cells of a sweep."""

    total: int
    without_data: int  # their scene is not on disk


def plan_sweep(cfg: DictConfig) -> CellCount:
    """Write the plan of a sweep; print one error for all missing scenes, one for each missing prior, and the number of
    its cells.

    Raises SystemExit(1) for an unknown scene.
    """
    dataset = instantiate(cfg.dataset.loader)
    options = swept(cfg)
    names = options.get("scene") or [cfg.scene]
    try:
        scenes = [dataset.describe(name) for name in names]
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
    if (number_of_jobs(cfg) or 1) > 1:
        cells = planned_cells(cfg, plan, dict(zip(map(str, names), scenes, strict=True)), missing)
        write_cells(Path(cfg.hydra.sweep.dir), cells)
        say(f"{cfg.name}: {count_by_state(cells)}", stderr=True)
    per_scene = math.prod(len(values) or 1 for key, values in options.items() if key != "scene")
    return CellCount(per_scene * len(scenes), per_scene * len(missing))


def planned_cells(cfg: DictConfig, plan: Plan, scenes: dict[str, Description], missing: list[str]) -> list[PlannedCell]:
    """Return the cell of each job. scenes: by the names that the options have. missing: those that are not on disk."""
    cells = []
    for overrides in overrides_of_jobs(cfg):
        chosen = dict(map(key_and_value, overrides))
        place = scenes[chosen.get("scene", str(cfg.scene))]
        kind = plan.title([o for o in overrides if key_and_value(o)[0] not in WITHIN_A_KIND])
        state: State = "without data" if place.scene in missing else "to run"
        if state == "to run" and cfg.overwrite != "always" and _has_result(cfg, chosen, place, plan.variant(overrides)):
            state = "with a result"
        cells.append(PlannedCell(kind, place.scene, state))
    return cells


def _has_result(cfg: DictConfig, chosen: dict[str, str], place: Description, variant: str) -> bool:
    """Return whether a finished cell is in the folder of a job's cell. chosen: the job's options."""
    method, init = chosen.get("method", cfg.method.name), chosen.get("init", cfg.init.name)
    seed, name = chosen.get("seed", str(cfg.seed)), chosen.get("name", cfg.name)
    if not seed.isdigit():  # the job will say what is wrong
        return False
    record = Record(method, place.dataset, place.scene, init, int(seed), name, variant)
    found = readable_record(cell_folder_of(Path(chosen.get("results", cfg.results)) / name, record))
    return found is not None and found.status == "ok"

"""Before a sweep: write its plan, count its cells, and name missing scenes and priors before hours of work begin."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.options import OptionError, check_options, names_to_text
from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.plan import IN_THE_PATH, Plan, configs_by, key_and_value, number_of_jobs, overrides_of_jobs, swept
from tdgbench.bench.record import Record
from tdgbench.bench.stored import readable_record
from tdgbench.experiments.experiment import prepare_prior
from tdgbench.priors import PriorUnavailableError
from tdgbench.scenes import Description, SceneError
from tdgbench.terminal import say


class CellCount(NamedTuple):
    """Number of cells of a sweep: all, those whose scene is not on disk, and those whose folder has a result.

    Settings, data and code of a result may be others: that shows when its cell's turn comes.
    """

    total: int
    without_data: int
    with_result: int = 0

    @property
    def to_run(self) -> int:
        """Number of cells that have data and no result."""
        return self.total - self.without_data - self.with_result

    def __str__(self) -> str:
        """Return the numbers in words.

        >>> print(CellCount(4, without_data=1, with_result=2))
        4 cells: 1 to run, 2 with a result, 1 without data
        """
        return (
            f"{self.total} cells: {self.to_run} to run, {self.with_result} with a result, "
            f"{self.without_data} without data"
        )


def plan_sweep(cfg: DictConfig) -> CellCount:
    """Write the plan of a sweep, and print the number of its cells, all missing scenes, and missing priors.

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
    count = CellCount(len(scenes), len(missing))
    if (number_of_jobs(cfg) or 1) > 1:
        count = count_cells(cfg, plan, dict(zip(map(str, names), scenes, strict=True)), missing)
        plan.cells_to_run = count.to_run
        say(f"{cfg.name}: {count}", stderr=True)
    plan.write(Path(cfg.results) / cfg.name)  # for the tables
    plan.write(Path(cfg.hydra.sweep.dir))  # for the jobs: another sweep may replace the other one meanwhile
    return count


def count_cells(cfg: DictConfig, plan: Plan, scenes: dict[str, Description], missing: list[str]) -> CellCount:
    """Return the number of a sweep's cells. scenes: by the names that the options have. missing: not on disk."""
    total = without_data = with_result = 0
    for overrides in overrides_of_jobs(cfg):
        chosen = dict(map(key_and_value, overrides))
        place = scenes[chosen.get("scene", str(cfg.scene))]
        total += 1
        if place.scene in missing:
            without_data += 1
        elif cfg.overwrite != "always" and _has_result(cfg, chosen, place, plan.variant(overrides)):
            with_result += 1
    return CellCount(total, without_data, with_result)


def _has_result(cfg: DictConfig, chosen: dict[str, str], place: Description, variant: str) -> bool:
    """Return whether a finished cell is in the folder of a job's cell. chosen: the job's options."""
    method, init = chosen.get("method", cfg.method.name), chosen.get("init", cfg.init.name)
    seed, name = chosen.get("seed", str(cfg.seed)), chosen.get("name", cfg.name)
    if not seed.isdigit():  # the job will say what is wrong
        return False
    record = Record(method, place.dataset, place.scene, init, int(seed), name, variant)
    stored = readable_record(cell_folder_of(Path(chosen.get("results", cfg.results)) / name, record))
    return stored is not None and stored.status == "ok"


def unavailable_priors(cells: Iterable[DictConfig]) -> list[str]:
    """Return messages for the priors that cells need and that are not available, one each.

    Cells with options that are not allowed say so themselves when they run.
    """
    messages: dict[str, None] = {}
    for cfg in cells:
        try:
            check_options(names_to_text(cfg))
            prepare_prior(cfg)
        except PriorUnavailableError as error:
            messages[str(error)] = None
        except OptionError:
            continue
    return list(messages)

"""Before a sweep: write its plan, count its cells, and name missing scenes and priors before hours of work begin."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.options import OptionError, check_cell_names, check_options, names_to_text, without_hydra
from tdgbench.bench.progress import Outcome
from tdgbench.bench.run_cell import known_outcome
from tdgbench.cells.plan import (
    IN_THE_PATH,
    Command,
    Jobs,
    MethodEntry,
    Plan,
    method_entries,
    number_of_jobs,
    read_plan,
    swept,
)
from tdgbench.cells.record import record_files
from tdgbench.experiments.experiment import prepare_prior
from tdgbench.priors import PriorUnavailableError
from tdgbench.scenes import Dataset, Description, SceneError
from tdgbench.tables.measures import entries_of
from tdgbench.terminal import say
from tdgbench.text import without_folders

SWEEPER = "hydra._internal.core_plugins.basic_sweeper.BasicSweeper"


def plan_sweep(cfg: DictConfig, jobs: Jobs) -> tuple[Plan, int, int]:
    """Plan a sweep, and print the number of its cells, all missing scenes, and missing priors.

    Returns the plan, the number of cells, or of scenes where the sweeper decides on the cells, and how many of them are
    not on disk. Raises SystemExit(1) for an unknown scene.
    """
    try:
        scenes, missing = _scenes_of(cfg, jobs.configs_by(("dataset", "data")))
    except SceneError as error:
        say(str(error), "error:", stderr=True)
        raise SystemExit(1) from error
    for message in unavailable_priors(jobs.configs_by(("method", "dataset", "prior"))):
        say(f"{message}\n  cells of methods without a prior run", "error:", stderr=True)
    known = number_of_jobs(cfg)
    cells = known or max(len(scenes), 1)
    without_data = round(missing * cells)
    if cells > 1:
        counted = "scenes" if known is None else "cells"
        say(f"{cfg.name}: {cells} {counted}, {without_data} of them without data", stderr=True)
    plan = _plan_of(cfg, list(dict.fromkeys(scenes)), cells - without_data if known else 0)
    before = plan_before(Path(cfg.results) / cfg.name)
    plan.commands = [*(one for one in before.commands if one.words != plan.commands[0].words), *plan.commands]
    plan.own_methods = before.own_methods | _own_methods(cfg)
    plan.own_metrics = before.own_metrics
    for one in filter(_is_allowed, jobs.configs_by(("metrics",))):
        plan.own_metrics |= entries_of(OmegaConf.select(one, "metrics.extra") or ())
    return plan, cells, without_data


def finished_outcomes(cfg: DictConfig, jobs: Jobs, plan: Plan) -> list[Outcome]:
    """Return the outcomes of a sweep of which no cell has to run; none if a cell has to, or a job has to tell.

    Its jobs would say the same, but Hydra composes each twice, and its launcher may start processes for them.
    """
    folder, outcomes = Path(cfg.results) / cfg.name, list[Outcome]()
    if sum(1 for _ in record_files(folder)) < plan.cells_with_data or cfg.hydra.sweeper._target_ != SWEEPER:
        return []
    for words in jobs.words:
        one = jobs.compose(words)
        try:
            check_cell_names(one, one.hydra.runtime.choices)
            outcome = known_outcome(names_to_text(without_hydra(one)), plan.variant(words))
        except Exception:  # whatever it is, the job says it
            return []
        if outcome is None:
            return []
        outcomes.append(outcome)
    return outcomes


def _scenes_of(cfg: DictConfig, by_dataset: Iterable[DictConfig]) -> tuple[list[Description], float]:
    """Return the scenes of each data set of a sweep, and the share of its cells whose scene is not on disk.

    Scenes that are not on disk are printed. Cells with options that are not allowed do not count: they fail later.
    Raises SceneError for an unknown scene; in a folder of captures, one that is not there.
    """
    scenes, missing, configs = list[Description](), 0.0, list(by_dataset)
    for one in filter(_is_allowed, configs):
        dataset: Dataset = instantiate(one.dataset.loader)
        described = [dataset.describe(name) for name in swept(cfg).get("scene") or [one.scene]]
        absent = dataset.missing([scene.scene for scene in described])
        if not {*absent} <= {*dataset.names()}:
            raise SceneError(dataset.explain_missing(absent))
        if absent:
            say(dataset.explain_missing(absent), "error:", stderr=True)
        scenes += described
        missing += sum(scene.scene in absent for scene in described) / len(described) / len(configs)
    return scenes, missing


def _plan_of(cfg: DictConfig, scenes: list[Description], cells_with_data: int) -> Plan:
    """Return the plan of a sweep over these scenes. cells_with_data: 0 where the sweeper decides."""
    options = swept(cfg)
    alike = len(scenes) < len(options.get("scene") or [""]) * len(set(options.get("dataset", [""])))  # in titles
    return Plan(
        table=cfg.table,
        scenes=scenes,
        methods=options.get("method", [cfg.method.name]),
        inits=options.get("init", [cfg.init.name]),
        variant_keys=[key for key in options if key not in IN_THE_PATH or (alike and key == "dataset")],
        cells_with_data=cells_with_data,
        commands=[
            Command(without_folders(shlex.join(["tdgbench", *sys.argv[1:]])), f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC")
        ],
    )


def plan_before(experiment: Path) -> Plan:
    """Return the plan in an experiment's folder; an empty one where it cannot be read, and is replaced."""
    try:
        return read_plan(experiment)
    except (OSError, ValueError):
        return Plan()


def _own_methods(cfg: DictConfig) -> dict[str, MethodEntry]:
    """Return how tables print the chosen methods of the user's folders, and what is typed for a single method."""
    entries: dict[str, MethodEntry] = {}
    chosen = swept(cfg).get("method") or [cfg.hydra.runtime.choices.method]
    for source in cfg.hydra.runtime.config_sources:
        if source.provider == "command-line":
            entries |= method_entries(Path(source.path), chosen)
    typed = {key: cfg.method[key] for key in MethodEntry._fields if f"method.{key}" in _typed_keys(cfg)}
    if typed and len(chosen) == 1:
        name = str(cfg.method.name)
        entries[name] = entries.get(name, MethodEntry(name))._replace(**typed)
    return entries


def _typed_keys(cfg: DictConfig) -> set[str]:
    return {word.lstrip("+").partition("=")[0] for word in cfg.hydra.overrides.task}


def unavailable_priors(cells: Iterable[DictConfig]) -> list[str]:
    """Return messages for the priors that cells need and that are not available, one each."""
    messages: dict[str, None] = {}
    for cfg in filter(_is_allowed, cells):
        try:
            prepare_prior(cfg)
        except PriorUnavailableError as error:
            messages[str(error)] = None
    return list(messages)


def _is_allowed(cfg: DictConfig) -> bool:
    """Return whether a cell has options that are allowed; others say so themselves when they run."""
    try:
        check_options(names_to_text(cfg))
    except OptionError:
        return False
    return True

"""Before and after a run or sweep: say which scenes are missing; then tables, pictures, failures, exit status."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console
from rich.markup import escape

from tdgbench.bench.plan import IN_THE_PATH, Plan, swept
from tdgbench.experiments.sweep.job import read_outcomes
from tdgbench.report.page import write_report
from tdgbench.report.strip import draw_strip
from tdgbench.scenes import SceneError
from tdgbench.tables.build import build_tables
from tdgbench.tables.show import show


class Finish(Callback):
    """A Hydra callback; the same for one cell and for many, and for every launcher."""

    def on_run_start(self, config: DictConfig, **kwargs: Any) -> None:
        self._start(config)

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        self._start(config)

    def on_run_end(self, config: DictConfig, **kwargs: Any) -> None:
        self._end(config, Path(config.hydra.run.dir))

    def on_multirun_end(self, config: DictConfig, **kwargs: Any) -> None:
        self._end(config, Path(config.hydra.sweep.dir))

    def _start(self, config: DictConfig) -> None:
        """Plan the experiment, and name every missing scene in one message before hours of work begin."""
        console = Console(stderr=True)
        experiment = Path(config.results) / config.name
        dataset = instantiate(config.dataset.loader)
        sweep = swept(config)
        try:
            names = sweep.get("scene", [config.scene])
            found = [dataset.describe(name) for name in names]
            missing = dataset.missing([what.scene for what in found])
        except SceneError as error:
            console.print(f"[red]error:[/red] {escape(str(error))}", highlight=False, soft_wrap=True)
            raise SystemExit(1) from error
        if missing:
            message = escape(dataset.explain_missing(missing))
            console.print(f"[red]error:[/red] {message}", highlight=False, soft_wrap=True)
        Plan(
            table=config.table,
            scenes=[vars(what) for what in found],
            methods=sweep.get("method", [config.method.name]),
            inits=sweep.get("init", [config.init.name]),
            variant_keys=[key for key in sweep if key not in IN_THE_PATH],
        ).write(experiment)

    def _end(self, config: DictConfig, hydra_folder: Path) -> None:
        """Tables and pictures of everything on disk; one line per failure; exit status 1 if anything is lacking."""
        console = Console()
        experiment = Path(config.results) / config.name
        outcomes = read_outcomes(hydra_folder)
        problem = None
        try:
            _write_all(experiment, console)
        except Exception as error:  # Hydra would make a warning of it and end with status 0
            problem = f"{type(error).__name__}: {error}"
        count = {s: sum(o.status == s for o in outcomes) for s in ("ok", "kept", "elsewhere", "failed", "missing")}
        console.print(
            f"{count['ok']} cells run, {count['kept']} already there, {count['failed']} failed, "
            f"{count['missing']} without data"
            + (f", {count['elsewhere']} in the hands of another process" if count["elsewhere"] else ""),
            highlight=False,
        )
        for outcome in outcomes:
            if outcome.status == "failed":
                message = escape(f"{outcome.title}: {outcome.message}")
                console.print(f"[red]failed:[/red] {message}", highlight=False, soft_wrap=True)
        if problem is not None:
            message = f"tables and report are not written: {escape(problem)}; the cells are"
            console.print(f"[red]error:[/red] {message}", highlight=False, soft_wrap=True)
        if problem is not None or count["failed"] or count["missing"]:
            raise SystemExit(1)


def _write_all(experiment: Path, console: Console) -> None:
    """Tables, pictures and report of everything on disk, and where they are."""
    tables = build_tables(experiment)
    show(tables, console)
    console.print(f"tables: {tables.folder}", highlight=False, soft_wrap=True)
    if draw_strip(tables.records, experiment, experiment / "strip.png"):
        console.print(f"pictures: {experiment / 'strip.png'}", highlight=False, soft_wrap=True)
    page = write_report(experiment, tables)
    console.print(f"report: {page}", highlight=False, soft_wrap=True)

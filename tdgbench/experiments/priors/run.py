"""`+experiment=priors`: judge each depth prior, train TDg with it, and compare with TDg without depth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

from hydra.utils import instantiate
from omegaconf import DictConfig
from pydantic import Field, NonNegativeInt

from tdgbench.bench.cell import run_cell
from tdgbench.bench.outcome import SUCCESS, finished_cells
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.setup import loader_of
from tdgbench.experiments.error_time.show import show
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.priors.judge import Judged, judge
from tdgbench.experiments.priors.table import NONE, Entry, as_text, latex, prior_rows, reasons, view_rows
from tdgbench.experiments.priors.truth import source
from tdgbench.files import write_text
from tdgbench.scenes import Scene, SceneError
from tdgbench.splats.cpu import pool
from tdgbench.tables.as_csv import as_csv
from tdgbench.terminal import console, say


@dataclass(frozen=True)
class PriorsOptions:
    """Options in `cfg.job`. priors: by name, as in `conf/prior/`. without: the method that is TDg without depth."""

    scenes: Annotated[list[str | None], Field(min_length=1)]
    seeds: Annotated[list[NonNegativeInt], Field(min_length=1)]
    priors: dict[str, Any]
    without: dict[str, Any]


class Priors(Experiment):
    """Error of each prior, and TDg's scores with it."""

    options = PriorsOptions
    sets: ClassVar[Mapping[str, str]] = {
        "scene": "job.scenes=[NAME,...]",
        "seed": "job.seeds=[0,...]",
        "prior": "job.priors",
    }

    def run(self, cfg: DictConfig) -> None:
        """Judge the priors, run the cells that have no result, write and print the tables.

        A prior that cannot be had is n/a. Raises SystemExit(1) if a scene could not be read or a cell failed.
        """
        self.check(cfg)
        pool.set_threads(cfg.threads)
        entries: list[Entry] = []
        failures: list[str] = []
        for name in cfg.job.scenes:
            try:
                entries += _entries(cfg, name, failures)
            except SceneError as error:
                failures.append(str(error))
        folder = Path(cfg.results) / cfg.name
        if entries:
            table = prior_rows(entries)
            write_text(folder / "priors.csv", as_csv(table, na_rep="n/a"))
            write_text(folder / "priors_views.csv", as_csv(view_rows(entries), na_rep="n/a"))
            write_text(folder / "priors.tex", latex(table))
            for scene, rows in table.groupby("scene", sort=False):
                truth = next((text for text in rows["truth"] if text), "nothing")
                title = f"{scene}: depth priors against {truth}, and TDg with each"
                show(as_text(rows, ("scene", "made_from")), console(), title)
            for reason in reasons(table):
                say(reason, "n/a:", "yellow")
            say(f"tables: {folder / 'priors.csv'}, {folder / 'priors_views.csv'}, {folder / 'priors.tex'}")
        for failure in failures:
            say(failure, "failed:")
        if failures:
            raise SystemExit(1)


def _entries(cfg: DictConfig, name: str | None, failures: list[str]) -> Iterator[Entry]:
    """The rows of one scene: TDg without depth, then each prior. Raises SceneError."""
    scene: Scene = instantiate(loader_of(cfg, instantiate(cfg.skip))).load(name)
    cache = Path(cfg.results) / "cache" / "priors"
    yield _trained(cfg, scene, NONE, Judged(), failures)
    for prior, options in cfg.job.priors.items():
        judged = judge(options, scene, cache)
        made_from = str(options.get("made_from") or "")
        if judged.reason:
            yield Entry(scene.name, str(prior), made_from, "", judged, [])
        else:
            yield _trained(cfg, scene, str(prior), judged, failures)


def _trained(cfg: DictConfig, scene: Scene, prior: str, judged: Judged, failures: list[str]) -> Entry:
    """Run the cells of one prior, one per seed, and collect their records."""
    outcomes = []
    for seed in cfg.job.seeds:
        cell = cfg.copy()
        cell.scene, cell.seed = scene.name, seed
        if prior == NONE:
            cell.method = cfg.job.without
        else:
            cell.prior = cfg.job.priors[prior]
        outcome = run_cell(cell, f"prior={prior}", CellProgress(console(stderr=True), cfg.budget.iterations))
        outcomes.append(outcome)
        if outcome.status not in SUCCESS:
            failures.append(f"{outcome.title}: {outcome.message}")
    done = finished_cells(Path(cfg.results) / cfg.name, outcomes)
    made_from = "" if prior == NONE else str(cell.prior.get("made_from") or "")
    reason = "" if len(done) == len(cfg.job.seeds) else "a training failed"
    return Entry(scene.name, prior, made_from, source(scene), judged, done, reason)

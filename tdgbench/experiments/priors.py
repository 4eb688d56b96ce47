"""`+experiment=priors`: the error of each depth prior, and TDg's scores with it, next to TDg without depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.failures import message
from tdgbench.bench.setup import loader_of
from tdgbench.cells.paths import prior_cache
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.matrix import (
    AxisValue,
    MatrixCell,
    MatrixOptions,
    check_all_ran,
    groups_of,
    run_cells,
    values_of,
)
from tdgbench.experiments.prior_accuracy import Accuracy, PriorErrors, measure_prior, source
from tdgbench.files import write_text
from tdgbench.splats.cpu import pool
from tdgbench.tables.as_csv import as_csv
from tdgbench.tables.show import format_columns, show_table
from tdgbench.terminal import say

NONE = "none"  # TDg without its depth loss
SCORES = ("psnr", "ssim", "lpips", "depth_abs_rel")
SHOWN = {  # on the terminal: title, format
    "prior": ("prior", "{}"),
    "abs_rel": ("AbsRel", "{:.3f}"), "delta": ("δ<1.25", "{:.3f}"), "rank": ("rank", "{:.2f}"),
    "psnr": ("PSNR", "{:.2f}"), "psnr_gain": ("gain", "{:+.2f}"), "ssim": ("SSIM", "{:.3f}"),
    "lpips": ("LPIPS", "{:.3f}"),
}  # fmt: skip


@dataclass(frozen=True)
class PriorsOptions(MatrixOptions):
    """Options in `cfg.study`. priors: by name, as in `conf/prior/`. without: the method that is TDg without depth."""

    priors: dict[str, Any]
    without: dict[str, Any]


class Priors(Experiment):
    """Error of each prior, and TDg's scores with it."""

    options = PriorsOptions
    one_job = True
    sets: ClassVar[Mapping[str, str]] = {**MatrixOptions.SETS, "prior": "study.priors"}

    def run(self, cfg: DictConfig) -> None:
        """Measure the priors, run the cells that have no result, write and print the tables.

        A prior that is not available is n/a. Raises SystemExit(1) if a scene could not be read or a cell failed.
        """
        self.check(cfg)
        pool.set_threads(cfg.threads)
        tables: list[SceneTables] = []
        for name in cfg.study.scenes:
            try:
                tables.append(run_scene(cfg, name))
            except Exception as error:  # such as a network's for lack of memory; the other scenes are measured
                say(message(error), "failed:")
        if tables:
            _write(Path(cfg.results) / cfg.name, tables)
        check_all_ran(cell for scene in tables for cell in scene.cells)
        if len(tables) < len(cfg.study.scenes):
            raise SystemExit(1)


class SceneTables(NamedTuple):
    """The cells of a scene, and its rows of the tables.

    priors: a row per prior; errors are means over the training views, scores means over the seeds. psnr_gain: PSNR
    minus that without a prior, mean over the seeds that both have. reason: why numbers are missing. views: a row per
    prior and training view.
    """

    cells: list[MatrixCell]
    priors: list[dict[str, Any]]
    views: list[dict[str, Any]]


def run_scene(cfg: DictConfig, name: str | None) -> SceneTables:
    """Measure each prior on a scene, and run TDg without depth and with each prior that is available.

    Raises SceneError if the scene cannot be read.
    """
    scene = instantiate(loader_of(cfg, instantiate(cfg.skip))).load(name)
    cfg = cfg.copy()
    cfg.seed = cfg.study.seeds[0]  # errors are of the prior of one training
    priors, cache = cfg.study.priors, prior_cache(Path(cfg.results))
    errors = {str(prior): measure_prior(options, scene, cache) for prior, options in priors.items()}
    available = {prior: priors[prior] for prior, error in errors.items() if not error.reason}
    without = AxisValue(NONE, {"method": cfg.study.without}, f"prior={NONE}")
    axes = {
        "scene": values_of("scene", [scene.name]),
        "prior": [without, *groups_of("prior", available, variant="prior")],
        "seed": values_of("seed", cfg.study.seeds),
    }
    cells, rows, views = run_cells(cfg, axes), [], []
    scores = {prior: _scores(cells, prior) for prior in (NONE, *errors)}
    for prior, error in {NONE: PriorErrors(), **errors}.items():
        place = {"scene": scene.name, "prior": prior}
        failed = "" if error.reason or len(scores[prior]) == len(cfg.study.seeds) else "a training failed"
        rows.append(
            {
                **place,
                "made_from": "" if prior == NONE else str(priors[prior].get("made_from") or ""),
                "kind": error.kind,
                "truth": source(scene) if error.views else "",
                "views": len(error.views),
                **error.mean._asdict(),
                "seeds": len(scores[prior]),
                **scores[prior].mean(skipna=False),
                "psnr_gain": np.nan if prior == NONE else (scores[prior]["psnr"] - scores[NONE]["psnr"]).mean(),
                "reason": error.reason or failed,
            }
        )
        views += [{**place, "view": view, **accuracy._asdict()} for view, accuracy in error.views.items()]
    return SceneTables(cells, rows, views)


def _scores(cells: Sequence[MatrixCell], prior: str) -> pd.DataFrame:
    """Return SCORES of the finished cells with a prior by seed, NaN for n/a."""
    records = [cell.record for cell in cells if cell.labels["prior"] == prior and cell.record is not None]
    seeds = [record.seed for record in records]
    return pd.DataFrame([record.scores for record in records], seeds, list(SCORES), dtype=float)


def reasons(table: pd.DataFrame) -> list[str]:
    """Say why numbers are missing, one line per reason, with the places."""
    places = (table["prior"] + " on " + table["scene"])[table["reason"] != ""]
    return [f"{', '.join(where)}: {reason}" for reason, where in places.groupby(table["reason"], sort=False)]


def _write(folder: Path, tables: Sequence[SceneTables]) -> None:
    """Write and print the tables."""
    table = pd.DataFrame([row for scene in tables for row in scene.priors])
    views = [row for scene in tables for row in scene.views]
    view_table = pd.DataFrame(views, columns=["scene", "prior", "view", *Accuracy._fields])
    write_text(folder / "priors.csv", as_csv(table, na_rep="n/a"))
    write_text(folder / "priors_views.csv", as_csv(view_table, na_rep="n/a"))
    for scene, rows in table.groupby("scene", sort=False):
        truth = next((text for text in rows["truth"] if text), "nothing")
        shown = format_columns(rows, SHOWN)
        show_table(shown, f"{scene}: depth priors against {truth}, and TDg with each")
    for reason in reasons(table):
        say(reason, "n/a:", "yellow")
    say(f"tables: {folder / 'priors.csv'}, {folder / 'priors_views.csv'}")

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

from tdgbench.bench.record import Record
from tdgbench.bench.setup import loader_of
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.matrix import (
    Choice,
    MatrixCell,
    MatrixOptions,
    check_all_ran,
    groups_of,
    run_cells,
    values_of,
)
from tdgbench.experiments.prior_accuracy import Judged, judge, source
from tdgbench.experiments.show import as_text, show
from tdgbench.files import write_text
from tdgbench.scenes import SceneError
from tdgbench.splats.cpu import pool
from tdgbench.tables.as_csv import as_csv
from tdgbench.tables.latex import comment, escape
from tdgbench.terminal import console, say

NONE = "none"  # TDg without its depth loss
SCORES = ("psnr", "ssim", "lpips", "depth_abs_rel")
WORDS = {name: (name.replace("_", " "), "{}") for name in ("scene", "prior", "made_from")}
SHOWN = {  # numbers on the terminal and in LaTeX: title, format
    "abs_rel": ("AbsRel", "{:.3f}"), "delta": ("δ<1.25", "{:.3f}"), "rank": ("rank", "{:.2f}"),
    "psnr": ("PSNR", "{:.2f}"), "psnr_gain": ("gain", "{:+.2f}"), "ssim": ("SSIM", "{:.3f}"),
    "lpips": ("LPIPS", "{:.3f}"),
}  # fmt: skip


@dataclass(frozen=True)
class PriorsOptions(MatrixOptions):
    """Options in `cfg.job`. priors: by name, as in `conf/prior/`. without: the method that is TDg without depth."""

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

        A prior that is not available is n/a. Raises SystemExit(1) if a scene could not be read or a cell failed.
        """
        self.check(cfg)
        pool.set_threads(cfg.threads)
        entries: list[Entry] = []
        cells: list[MatrixCell] = []
        all_read = True
        for name in cfg.job.scenes:
            try:
                of_scene, ran = run_scene(cfg, name)
            except SceneError as error:
                say(str(error), "failed:")
                all_read = False
            else:
                entries, cells = entries + of_scene, cells + ran
        if entries:
            _write(Path(cfg.results) / cfg.name, entries)
        check_all_ran(cells)
        if not all_read:
            raise SystemExit(1)


class Entry(NamedTuple):
    """A prior on a scene: how it was judged, and the records of TDg's finished cells with it, one per seed."""

    scene: str
    prior: str
    made_from: str
    truth: str
    judged: Judged
    records: Sequence[Record]
    reason: str = ""  # why a number is missing


def run_scene(cfg: DictConfig, name: str | None) -> tuple[list[Entry], list[MatrixCell]]:
    """Judge each prior on a scene, and run TDg without depth and with each prior that is available.

    Raises SceneError if the scene cannot be read.
    """
    scene = instantiate(loader_of(cfg, instantiate(cfg.skip))).load(name)
    priors, cache = cfg.job.priors, Path(cfg.results) / "cache" / "priors"
    judged = {str(prior): judge(options, scene, cache) for prior, options in priors.items()}
    available = {prior: priors[prior] for prior, found in judged.items() if not found.reason}
    without = Choice(NONE, {"method": cfg.job.without}, f"prior={NONE}")
    axes = {
        "scene": values_of("scene", [scene.name]),
        "prior": [without, *groups_of("prior", available, variant="prior")],
        "seed": values_of("seed", cfg.job.seeds),
    }
    cells, entries = run_cells(cfg, axes), []
    for prior, found in {NONE: Judged(), **judged}.items():
        records = [cell.record for cell in cells if cell.labels["prior"] == prior and cell.record is not None]
        made_from = "" if prior == NONE else str(priors[prior].get("made_from") or "")
        truth = "" if found.reason else source(scene)
        failed = "" if found.reason or len(records) == len(cfg.job.seeds) else "a training failed"
        entries.append(Entry(scene.name, prior, made_from, truth, found, records, found.reason or failed))
    return entries, cells


def prior_rows(entries: Sequence[Entry]) -> pd.DataFrame:
    """One row per scene and prior. Errors are means over the training views, scores means over the seeds.

    psnr_gain: PSNR minus that without a prior, mean over the seeds that both have. reason: why numbers are missing.
    """
    without = {(e.scene, r.seed): r.scores.get("psnr") for e in entries if e.prior == NONE for r in e.records}
    rows = []
    for entry in entries:
        found = entry.judged.mean
        gains = [
            record.scores["psnr"] - base  # type: ignore[operator]
            for record in entry.records
            if (base := without.get((entry.scene, record.seed))) is not None and entry.prior != NONE
        ]
        rows.append(
            {
                "scene": entry.scene, "prior": entry.prior, "made_from": entry.made_from, "kind": entry.judged.kind,
                "truth": entry.truth if found else "", "views": len(entry.judged.views),
                **{name: np.nan if found is None else getattr(found, name) for name in ("abs_rel", "delta", "rank")},
                "seeds": len(entry.records), **{name: _mean(entry.records, name) for name in SCORES},
                "psnr_gain": float(np.mean(gains)) if gains else np.nan, "reason": entry.reason,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def view_rows(entries: Sequence[Entry]) -> pd.DataFrame:
    """One row per scene, prior and training view."""
    rows = [
        {"scene": entry.scene, "prior": entry.prior, "view": view, **one._asdict()}
        for entry in entries
        for view, one in entry.judged.views.items()
    ]
    return pd.DataFrame(rows, columns=["scene", "prior", "view", "abs_rel", "delta", "rank"])


def reasons(table: pd.DataFrame) -> list[str]:
    """Why numbers are missing, one line per reason, with the places."""
    places: dict[str, list[str]] = {}
    for row in table[table["reason"] != ""].itertuples():
        places.setdefault(str(row.reason), []).append(f"{row.prior} on {row.scene}")
    return [f"{', '.join(where)}: {reason}" for reason, where in places.items()]


def latex(table: pd.DataFrame) -> str:
    """The same table as LaTeX; needs the package booktabs. Reasons of missing numbers are comments."""
    shown = as_text(table, WORDS | SHOWN)
    titles = [r"$\delta<1.25$" if title.startswith("δ") else escape(title) for title in shown.columns]
    lines = [
        *(comment(reason) for reason in reasons(table)),
        rf"\begin{{tabular}}{{{'l' * len(WORDS)}{'r' * len(SHOWN)}}}",
        r"\toprule",
        f"{' & '.join(titles)} \\\\",
    ]
    for _, group in shown.groupby("scene", sort=False):
        lines += [r"\midrule", *(f"{' & '.join(map(escape, row))} \\\\" for row in group.itertuples(index=False))]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _mean(records: Sequence[Record], name: str) -> float:
    values = [record.scores.get(name) for record in records]
    return float(np.mean(values)) if values and None not in values else np.nan  # type: ignore[arg-type]


def _write(folder: Path, entries: Sequence[Entry]) -> None:
    """Write and print the tables."""
    table = prior_rows(entries)
    write_text(folder / "priors.csv", as_csv(table, na_rep="n/a"))
    write_text(folder / "priors_views.csv", as_csv(view_rows(entries), na_rep="n/a"))
    write_text(folder / "priors.tex", latex(table))
    for scene, rows in table.groupby("scene", sort=False):
        truth = next((text for text in rows["truth"] if text), "nothing")
        shown = as_text(rows, {"prior": WORDS["prior"], **SHOWN})
        show(shown, console(), f"{scene}: depth priors against {truth}, and TDg with each")
    for reason in reasons(table):
        say(reason, "n/a:", "yellow")
    say(f"tables: {folder / 'priors.csv'}, {folder / 'priors_views.csv'}, {folder / 'priors.tex'}")

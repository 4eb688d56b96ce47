"""`+experiment=priors`: the error of each depth prior, and TDg's scores with it, next to TDg without depth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.failures import message
from tdgbench.bench.options import OptionError
from tdgbench.bench.setup import loader_of
from tdgbench.bench.signature import Problem
from tdgbench.cells.paths import prior_cache
from tdgbench.experiments.matrix import Axes, AxisValue, Matrix, MatrixCell, MatrixOptions, groups_of, values_of
from tdgbench.experiments.prior_accuracy import Accuracy, PriorErrors, measure_prior, source
from tdgbench.splats.cpu import pool
from tdgbench.tables.methods import label, paper_pair
from tdgbench.tables.palette import IMAGES
from tdgbench.tables.show import format_columns, show_table
from tdgbench.terminal import say

NONE = "none"  # the method without its depth loss
OF_TDG = "3dgs_smooth"  # which TDg is without
_SCORES = ("psnr", "ssim", "lpips", "depth_abs_rel")
_SHOWN = {  # on the terminal: title, format
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


class MeasuredScene(NamedTuple):
    """The error of each prior, by its name, against what is known of a scene's depth."""

    truth: str  # what that is
    errors: dict[str, PriorErrors]


class Priors(Matrix):
    """Error of each prior, and TDg's scores with it."""

    options = PriorsOptions
    sets: ClassVar[Mapping[str, str]] = {**Matrix.sets, "prior": "study.priors"}

    def __init__(self) -> None:
        self.measured: dict[str, MeasuredScene] = {}
        self.failed, self.label = 0, ""  # scenes; the method

    def run(self, cfg: DictConfig) -> None:
        """Measure the priors, run the cells that have no result, write and print the tables.

        A prior that is not available is n/a. Raises SystemExit(1) if a scene could not be read or a cell failed.
        """
        super().run(cfg)
        if self.failed:
            raise SystemExit(1)

    def axes(self, cfg: DictConfig) -> Axes:
        """Measure the priors. Return the scenes that could be read, TDg without depth and with each prior, seeds."""
        without = AxisValue(NONE, {"method": without_prior(cfg)}, f"prior={NONE}")
        pool.set_threads(cfg.threads)
        self.label = label(str(cfg.method.name))
        for name in cfg.study.scenes:
            try:
                self._measure(cfg, name)
            except Exception as error:  # such as a network's for lack of memory; the other scenes are measured
                say(message(error), "failed:")
                self.failed += 1
        return {
            "scene": values_of("scene", self.measured),
            "prior": [without, *groups_of("prior", cfg.study.priors, variant="prior")],
            "seed": values_of("seed", cfg.study.seeds),
        }

    def _measure(self, cfg: DictConfig, name: str | None) -> None:
        """Measure each prior on a scene. Raises SceneError if the scene cannot be read."""
        scene = instantiate(loader_of(cfg, instantiate(cfg.skip))).load(name)
        cfg = cfg.copy()
        cfg.seed = cfg.study.seeds[0]  # errors are of the prior of one training
        cache = prior_cache(Path(cfg.results))
        errors = {str(prior): measure_prior(one, scene, cache) for prior, one in cfg.study.priors.items()}
        self.measured[scene.name] = MeasuredScene(source(scene), errors)

    def is_cell(self, labels: Mapping[str, Any]) -> bool:
        """Return whether a prior is available for a scene."""
        errors = self.measured[labels["scene"]].errors
        return labels["prior"] == NONE or not errors[labels["prior"]].reason

    def tables(self, cfg: DictConfig, cells: Sequence[MatrixCell]) -> dict[str, pd.DataFrame]:
        """Return a row per scene and prior, and one per prior and training view.

        Errors are means over the training views, scores means over the seeds. psnr_gain: PSNR minus that without a
        prior, mean over all seeds, n/a where a training failed. reason: why numbers are missing.
        """
        seeds = list(cfg.study.seeds)
        made_from = {str(name): str(prior.get("made_from") or "") for name, prior in cfg.study.priors.items()}
        rows, views = [], []
        for scene, measured in self.measured.items():
            without = scores_of(_cells_of(cells, scene, NONE))
            for prior, error in {NONE: PriorErrors(), **measured.errors}.items():
                place, of_prior = {"scene": scene, "prior": prior}, _cells_of(cells, scene, prior)
                scores = scores_of(of_prior)
                gain = (scores["psnr"] - without["psnr"]).reindex(seeds).mean(skipna=False)
                failed = "" if len(scores) == len(seeds) else "a training failed"
                if not failed and len(without) < len(seeds):
                    failed = "a training without a prior failed"
                rows.append(
                    {
                        **place,
                        "made_from": made_from.get(prior, ""),
                        "kind": error.kind,
                        "truth": measured.truth if error.views else "",
                        "views": len(error.views),
                        **error.mean._asdict(),
                        "seeds": len(scores),
                        **scores.mean(skipna=False),
                        "psnr_gain": np.nan if prior == NONE else gain,
                        "reason": error.reason or failed,
                        IMAGES: self.image_values(of_prior),
                    }
                )
                views += [{**place, "view": view, **accuracy._asdict()} for view, accuracy in error.views.items()]
        if not rows:
            return {}
        return {
            "priors": pd.DataFrame(rows),
            "priors_views": pd.DataFrame(views, columns=["scene", "prior", "view", *Accuracy._fields]),
        }

    def show(self, table: pd.DataFrame) -> None:
        for scene, rows in table.groupby("scene", sort=False):
            truth = next((text for text in rows["truth"] if text), "nothing")
            show_table(
                format_columns(rows, _SHOWN), f"{scene}: depth priors against {truth}, and {self.label} with each"
            )
        for reason in reasons(table):
            say(reason, "n/a:", "yellow")


def without_prior(cfg: DictConfig) -> DictConfig:
    """Return the method without a prior, with the options and the length that the one with priors has, too.

    Raises OptionError for a method that is no variant of TDg beside TDg's own.
    """
    without, options, name = cfg.study.without.copy(), cfg.method.method, str(cfg.method.name)
    if without.name == OF_TDG and name.partition("_")[0] != paper_pair().method:
        what = f"is TDg without depth; choose what {label(name)} is without: method@study.without=NAME"
        raise OptionError([Problem("study.without", what, OF_TDG)])
    for name in without.method:
        if name in options and name != "_target_":
            without.method[name] = options[name]
    if "paper_iterations" in cfg.method:
        OmegaConf.update(without, "paper_iterations", cfg.method.paper_iterations, force_add=True)
    return without


def _cells_of(cells: Sequence[MatrixCell], scene: str, prior: str) -> list[MatrixCell]:
    return [cell for cell in cells if (cell.labels["scene"], cell.labels["prior"]) == (scene, prior)]


def scores_of(cells: Sequence[MatrixCell]) -> pd.DataFrame:
    """Return _SCORES of the finished ones of these cells by seed, NaN for n/a."""
    records = [cell.record for cell in cells if cell.record is not None]
    seeds = [record.seed for record in records]
    return pd.DataFrame([record.scores for record in records], seeds, list(_SCORES), dtype=float)


def reasons(table: pd.DataFrame) -> list[str]:
    """Say why numbers are missing, one line per reason, with the places."""
    places = (table["prior"] + " on " + table["scene"])[table["reason"] != ""]
    return [f"{', '.join(where)}: {reason}" for reason, where in places.groupby(table["reason"], sort=False)]

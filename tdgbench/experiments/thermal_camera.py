"""`+experiment=thermal_camera`: each method and `thermal_camera` on captures with known errors of one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from pydantic import Field

from tdgbench.cells.key import as_json
from tdgbench.cells.record import Record
from tdgbench.experiments.experiment import prepare_prior
from tdgbench.experiments.matrix import Axes, Matrix, MatrixCell, MatrixOptions, groups_of, table_of, values_of
from tdgbench.scenes.synthetic.capture import CameraTruth
from tdgbench.scenes.synthetic.drifting import DriftingDataset
from tdgbench.tables.long_table import metric_value
from tdgbench.tables.palette import IMAGES
from tdgbench.tables.show import format_columns, show_table
from tdgbench.thermal.camera import ViewResponses, normalized, normalized_truth
from tdgbench.thermal.maps import TERMS, evaluate

_SCORES = (
    "psnr", "ssim", "lpips", "psnr_affine", "psnr_right_half", "psnr_true", "mae_degC", "mae_degC_without_offset",
)  # fmt: skip
_PLACE = ["scene", "capture", "method", "thermal_camera"]
JUDGED = "psnr_true"  # by which what is lost and recovered is measured
_ERRORS = [f"{name}_{kind}" for name in ("offset_degC", "gain", "vignette_degC") for kind in ("rms", "worst")]
LOST = 0.5  # dB; of a smaller loss no share is given
SHOWN = {  # on the terminal: title, format
    "capture": ("capture", "{}"), "method": ("method", "{}"), "thermal_camera": ("camera", "{}"),
    "psnr": ("PSNR", "{:.2f}"),
    "psnr_affine": ("affine", "{:.2f}"), "psnr_right_half": ("right half", "{:.2f}"), "psnr_true": ("true", "{:.2f}"),
    "psnr_true_sem": ("±", "{:.2f}"), "recovered": ("recovered", "{:.0%}"), "ssim": ("SSIM", "{:.3f}"),
    "mae_degC": ("°C", "{:.3f}"), "mae_degC_without_offset": ("°C, no offset", "{:.3f}"),
    "offset_degC_worst": ("offset °C", "{:.3f}"), "gain_worst": ("gain", "{:.4f}"),
    "vignette_degC_worst": ("vignette °C", "{:.3f}"), "train_seconds": ("train s", "{:.1f}"),
    "camera_seconds": ("camera s", "{:.1f}"),
}  # fmt: skip


@dataclass(frozen=True)
class CaptureStudyOptions(MatrixOptions):
    """Options in `cfg.study`: what is combined.

    captures: errors by name, as `dataset.loader.errors.thermal_camera`, and noise_degC. thermal_cameras: as in
    `conf/thermal_camera/`.
    """

    methods: Annotated[dict[str, Any], Field(min_length=1)]
    captures: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]
    thermal_cameras: Annotated[dict[str, Any], Field(min_length=1)]


class ThermalCameraExperiment(Matrix):
    """Cells of all combinations, and their tables."""

    options = CaptureStudyOptions
    sets: ClassVar[Mapping[str, str]] = {
        **Matrix.sets, "method": "study.methods", "thermal_camera": "study.thermal_cameras",
    }  # fmt: skip

    def start(self, cfg: DictConfig) -> None:
        prepare_prior(cfg, cfg.study.methods.values())

    def axes(self, cfg: DictConfig) -> Axes:
        """Return scenes, captures with errors of the camera, methods, choices of `thermal_camera`, seeds."""
        study = cfg.study
        loaders = {str(name): _loader(cfg, errors) for name, errors in study.captures.items()}
        return {
            "scene": values_of("scene", study.scenes),
            "capture": groups_of("dataset.loader", loaders, variant="capture"),
            "method": groups_of("method", study.methods),
            "thermal_camera": groups_of("thermal_camera", study.thermal_cameras, variant="thermal_camera"),
            "seed": values_of("seed", study.seeds),
        }

    def tables(self, cfg: DictConfig, cells: Sequence[MatrixCell]) -> dict[str, pd.DataFrame]:
        errors = response_errors(cells)
        rows = table_of(cells, lambda record: numbers(record, errors.get(record.title, {})))
        return {} if rows.empty else {"thermal_camera": summary(rows, *baseline(cfg)), "thermal_camera_cells": rows}

    def show(self, table: pd.DataFrame) -> None:
        for scene, of_scene in table.groupby("scene", sort=False):
            title = f"{scene}: what the thermal camera costs, and what comes back"
            show_table(format_columns(of_scene, SHOWN), title)


def _loader(cfg: DictConfig, errors: Mapping[str, Any]) -> dict[str, Any]:
    """Return the configured data set, seen by a camera with the errors of a capture, which a cell's seed draws."""
    of_camera = {name: value for name, value in errors.items() if name != "noise_degC"}
    return {
        "_target_": "tdgbench.scenes.synthetic.drifting.DriftingDataset",
        "inner": OmegaConf.to_container(cfg.dataset.loader, resolve=True),
        "errors": {"_target_": "tdgbench.scenes.synthetic.ThermalErrors", **of_camera},
        "noise_degC": errors.get("noise_degC", 0.0),
        "seed": "${seed}",
    }


def baseline(cfg: DictConfig) -> tuple[str | None, str | None]:
    """Return the names of the capture without errors and of the camera that does nothing; None where there is none."""
    clean = (str(name) for name, errors in cfg.study.captures.items() if not any(errors.values()))
    ideal = (str(name) for name, camera in cfg.study.thermal_cameras.items() if not camera.estimate)
    return next(clean, None), next(ideal, None)


def response_errors(cells: Sequence[MatrixCell]) -> dict[str, dict[str, float]]:
    """Return the `camera_errors` of the finished cells that have temperatures, by the cell's title."""
    truths: dict[tuple[Any, ...], tuple[CameraTruth, list[str]]] = {}
    errors_by_cell = {}
    for cell in cells:
        if cell.record is None or not _has_errors(cell.record, cell.cfg.dataset.loader):
            continue  # a result of other options, which overwrite=never left
        key = (cell.record.scene, cell.labels["capture"], cell.labels["seed"])
        if key not in truths:
            dataset: DriftingDataset = instantiate(cell.cfg.dataset.loader)
            train = [view.name for view in dataset.outline(cell.record.scene).scene.train]
            truths[key] = dataset.truth(cell.record.scene), train
        errors_by_cell[cell.record.title] = camera_errors(cell.record, *truths[key])
    return errors_by_cell


def camera_errors(record: Record, truth: CameraTruth, train: Sequence[str]) -> dict[str, float]:
    """Return the errors of a cell's estimated thermal camera, named as in _ERRORS: root mean squares and largest ones.

    Empty for a scene without temperatures, or a true camera that stretches images. A cell without an estimate has the
    errors of an ideal camera, which are the drift itself. train: names of the training views.
    """
    if record.temperature_range is None or truth.camera.limits is not None:
        return {}
    facts = record.thermal_camera.get("estimated", {})
    if "offsets" not in facts:
        nothing = {"offsets": np.zeros(len(train)), "gains": np.ones(len(train)), "vignette": np.zeros(len(TERMS))}
        facts = {"views": train, "reference": truth.camera.reference, **nothing}
    offsets, gains, vignette = (np.array(facts[name], np.float64) for name in ("offsets", "gains", "vignette"))
    true = normalized_truth(truth, list(facts["views"]), float(facts["reference"]))
    height, width = true.vignette.shape
    estimated = normalized(ViewResponses(offsets, gains))
    parts = (
        estimated.offsets - true.response.offsets,
        estimated.gains - true.response.gains,
        evaluate(vignette, width, height) - true.vignette,
    )
    values = [float(value) for part in parts for value in (np.sqrt(np.mean(part**2)), np.abs(part).max())]
    return dict(zip(_ERRORS, values, strict=True))


def _has_errors(record: Record, loader: DictConfig) -> bool:
    """Return whether a cell was trained on captures with the errors of this loader."""
    options = as_json(OmegaConf.to_container(loader, resolve=True))
    return all(record.setting(f"dataset.{name}") == options[name] for name in ("errors", "noise_degC", "seed"))


def numbers(record: Record, errors: Mapping[str, float]) -> dict[str, Any]:
    """Return the numbers of a cell: scores, seconds, `camera_errors`; NaN where there is none."""
    return {
        **{name: metric_value(record, name)[0] for name in _SCORES},
        "train_seconds": record.seconds.get("train", np.nan),
        "camera_seconds": record.seconds.get("thermal_camera", 0.0),
        "iterations": record.iterations,
        "gaussians": sum(record.gaussians.values()),
        **{name: errors.get(name, np.nan) for name in _ERRORS},
        "notes": "; ".join(note for note in record.notes if note.startswith("thermal camera: ")),
    }


def summary(cells: pd.DataFrame, clean: str | None, ideal: str | None) -> pd.DataFrame:
    """Return the means over the seeds.

    clean, ideal: the capture without errors and the camera that does nothing. recovered: share of what a capture's
    errors cost the ideal camera in PSNR to the true temperatures that another camera brings back, of means over the
    seeds that have all it needs. psnr_true_sem: standard error of the mean; NaN for one seed.
    """
    groups = cells.groupby(_PLACE, sort=False)
    means = groups[[name for name in cells.columns if name not in (*_PLACE, "seed", "notes", IMAGES)]].mean()
    means["recovered"] = [_recovered(cells, place, clean, ideal) for place in means.index]
    means.insert(0, "seeds", groups["seed"].nunique())
    return means.assign(**{f"{JUDGED}_sem": groups[JUDGED].sem(), IMAGES: groups[IMAGES].first()}).reset_index()


def _recovered(cells: pd.DataFrame, place: tuple[str, ...], clean: str | None, ideal: str | None) -> float:
    """Return the share of the lost PSNR that a camera recovers; NaN where little was lost or no seed has all cells."""
    scene, capture, method, camera = place
    if capture == clean or camera == ideal:
        return float("nan")
    by_seed = cells.set_index([*_PLACE, "seed"])[JUDGED].unstack("seed")
    wanted = [(scene, clean, method, ideal), (scene, capture, method, ideal), place]
    if not all(one in by_seed.index for one in wanted):
        return float("nan")
    best, without, mine = by_seed.loc[wanted].dropna(axis=1).mean(axis=1)
    return float((mine - without) / (best - without)) if best - without >= LOST else float("nan")

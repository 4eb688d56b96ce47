"""`+experiment=thermal_camera`: each method on captures with known errors of the thermal camera, with each `camera`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from pydantic import Field, NonNegativeInt

from tdgbench.bench.cell import run_cell
from tdgbench.bench.outcome import Outcome
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Record, read_all
from tdgbench.experiments.error_time.show import show
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.preparation import prepare_prior
from tdgbench.experiments.thermal_camera.draw import draw_cameras, draw_scores
from tdgbench.experiments.thermal_camera.page import write_page
from tdgbench.experiments.thermal_camera.response import Comparison, compare
from tdgbench.experiments.thermal_camera.table import as_text, cell_rows, summary
from tdgbench.files import write_text
from tdgbench.scenes import SceneError
from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.tables.as_csv import as_csv
from tdgbench.terminal import console, say

SUCCESS = ("ok", "kept", "elsewhere")


@dataclass(frozen=True)
class ThermalCameraOptions:
    """Options in `cfg.job`: what is combined. The first capture has no errors, the first camera is ideal.

    captures: errors by name, as `dataset.loader.errors.camera`, and noise_degC. cameras: as in `conf/camera/`.
    """

    scenes: Annotated[list[str | None], Field(min_length=1)]  # None: the only one
    seeds: Annotated[list[NonNegativeInt], Field(min_length=1)]
    methods: Annotated[dict[str, Any], Field(min_length=1)]
    captures: Annotated[dict[str, dict[str, Any]], Field(min_length=1)]
    cameras: Annotated[dict[str, Any], Field(min_length=1)]


class ThermalCameraExperiment(Experiment):
    """Cells of all combinations, their table, pictures and page."""

    options = ThermalCameraOptions

    def start(self, cfg: DictConfig) -> None:
        """Raises PriorUnavailableError if the cells' prior is not available."""
        prepare_prior(cfg)

    def run(self, cfg: DictConfig) -> None:
        """Run the cells that have no result; write and print the table. Raises SystemExit(1) if a cell failed."""
        self.check(cfg)
        outcomes = list(_run_cells(cfg))
        folder, job = Path(cfg.results) / cfg.name, cfg.job
        captures, cameras = list(map(str, job.captures)), list(map(str, job.cameras))
        places = {variant(capture, camera): (capture, camera) for capture in captures for camera in cameras}
        records = [record for record in read_all(folder) if record.failure is None and record.variant in places]
        if records:
            compared = _comparisons(cfg, records, places)
            cells = cell_rows(records, places, compared)
            table = summary(cells, captures, cameras)
            write_text(folder / "thermal_camera_cells.csv", as_csv(cells, na_rep="n/a"))
            write_text(folder / "thermal_camera.csv", as_csv(table, na_rep="n/a"))
            draw_scores(table, folder / "scores.png")
            drawn = draw_cameras(compared, folder / "cameras.png")
            page = write_page(folder, table, [*(["cameras.png"] if drawn else []), "scores.png"])
            for scene, rows in table.groupby("scene", sort=False):
                show(as_text(rows), console(), f"{scene}: what the thermal camera costs, and what comes back")
            say(f"table: {folder / 'thermal_camera.csv'}, cells: {folder / 'thermal_camera_cells.csv'}, page: {page}")
        if any(outcome.status not in SUCCESS for outcome in outcomes):
            raise SystemExit(1)


def variant(capture: str, camera: str) -> str:
    """Name of a cell's variant."""
    return f"capture={capture},camera={camera}"


def _run_cells(cfg: DictConfig) -> Iterator[Outcome]:
    progress = CellProgress(console(stderr=True), cfg.budget.iterations)
    for scene in cfg.job.scenes:
        for seed in cfg.job.seeds:
            for capture in cfg.job.captures:
                for method in cfg.job.methods:
                    for camera in cfg.job.cameras:
                        cell = cfg.copy()
                        cell.scene, cell.seed = scene, seed
                        cell.method, cell.camera = cfg.job.methods[method], cfg.job.cameras[camera]
                        cell.dataset.loader = _loader(cfg, capture, seed)
                        outcome = run_cell(cell, variant(str(capture), str(camera)), progress)
                        say(outcome.line, stderr=True)
                        if outcome.status not in SUCCESS:
                            say(f"{outcome.title}: {outcome.message}", f"{outcome.status}:")
                        yield outcome


def _loader(cfg: DictConfig, capture: Any, seed: int) -> DictConfig:
    """The configured data set, seen by a camera with the errors of a capture."""
    errors = dict(cfg.job.captures[capture])
    noise = errors.pop("noise_degC", 0.0)
    return OmegaConf.create(
        {
            "_target_": "tdgbench.scenes.synthetic.drifting.DriftingDataset",
            "dataset": OmegaConf.to_container(cfg.dataset.loader, resolve=True),
            "errors": {"_target_": "tdgbench.scenes.synthetic.ThermalErrors", **errors},
            "noise_degC": noise,
            "seed": seed,
        }
    )


def _comparisons(cfg: DictConfig, records: list[Record], places: dict[str, tuple[str, str]]) -> list[Comparison]:
    """True and found cameras of the cells that found one in °C."""
    truths: dict[tuple[str, int, str], CameraTruth | None] = {}
    found = []
    for record in records:
        capture, camera = places[record.variant]
        key = (record.scene, record.seed, capture)
        if key not in truths:
            try:
                truths[key] = instantiate(_loader(cfg, capture, record.seed)).truth(record.scene)
            except (SceneError, OSError):
                truths[key] = None  # a scene of an earlier run, which is not there any more
        truth = truths[key]
        one = None if truth is None else compare(record, capture, camera, truth)
        if one is not None:
            found.append(one)
    return found

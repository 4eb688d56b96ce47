"""`+experiment=thermal_camera`: each method on captures with known errors of the thermal camera, with each `camera`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any, ClassVar

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from pydantic import Field, NonNegativeInt

from tdgbench.bench.cell import run_cell
from tdgbench.bench.key import as_json
from tdgbench.bench.outcome import SUCCESS, Outcome, finished_cells
from tdgbench.bench.progress import CellProgress
from tdgbench.bench.record import Record
from tdgbench.experiments.error_time.show import show
from tdgbench.experiments.experiment import Experiment
from tdgbench.experiments.preparation import prepare_prior
from tdgbench.experiments.thermal_camera.draw import draw_cameras, draw_scores
from tdgbench.experiments.thermal_camera.page import write_page
from tdgbench.experiments.thermal_camera.response import Comparison, compare
from tdgbench.experiments.thermal_camera.table import as_text, cell_rows, summary
from tdgbench.files import write_text
from tdgbench.scenes.synthetic.drifting import DriftingDataset
from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.tables.as_csv import as_csv
from tdgbench.terminal import console, say


@dataclass(frozen=True)
class ThermalCameraOptions:
    """Options in `cfg.job`: what is combined.

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
    sets: ClassVar[Mapping[str, str]] = {
        "scene": "job.scenes=[NAME,...]", "seed": "job.seeds=[0,...]", "method": "job.methods", "camera": "job.cameras",
    }  # fmt: skip

    def start(self, cfg: DictConfig) -> None:
        """Raises PriorUnavailableError if a method needs a prior that is not available."""
        for method in cfg.job.methods.values():
            cell = cfg.copy()
            cell.method = method
            prepare_prior(cell)

    def run(self, cfg: DictConfig) -> None:
        """Run the cells that have no result; write and print the table. Raises SystemExit(1) if a cell failed."""
        self.check(cfg)
        outcomes = list(_run_cells(cfg))
        folder, job = Path(cfg.results) / cfg.name, cfg.job
        captures, cameras = list(map(str, job.captures)), list(map(str, job.cameras))
        places = {variant(capture, camera): (capture, camera) for capture in captures for camera in cameras}
        records = finished_cells(folder, outcomes)
        if records:
            compared = _comparisons(cfg, records, places)
            cells = cell_rows(records, places, compared)
            table = summary(cells, captures, cameras, _baseline(cfg))
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


def _baseline(cfg: DictConfig) -> tuple[str | None, str | None]:
    """The capture without errors and the camera that does nothing, by their options; None where there is none."""
    clean = (str(name) for name, errors in cfg.job.captures.items() if not any(errors.values()))
    ideal = (str(name) for name, one in cfg.job.cameras.items() if not one.estimate)
    return next(clean, None), next(ideal, None)


def variant(capture: str, camera: str) -> str:
    """Name of a cell's variant."""
    return f"capture={capture},camera={camera}"


def _run_cells(cfg: DictConfig) -> Iterator[Outcome]:
    progress = CellProgress(console(stderr=True), cfg.budget.iterations)
    job = cfg.job
    for scene, seed, capture in product(job.scenes, job.seeds, job.captures):
        loader = _loader(cfg, capture, seed)
        for method, camera in product(job.methods, job.cameras):
            cell = cfg.copy()
            cell.scene, cell.seed = scene, seed
            cell.method, cell.camera, cell.dataset.loader = job.methods[method], job.cameras[camera], loader
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
            "inner": OmegaConf.to_container(cfg.dataset.loader, resolve=True),
            "errors": {"_target_": "tdgbench.scenes.synthetic.ThermalErrors", **errors},
            "noise_degC": noise,
            "seed": seed,
        }
    )


def _comparisons(cfg: DictConfig, records: list[Record], places: dict[str, tuple[str, str]]) -> list[Comparison]:
    """True and found cameras of the cells that have temperatures."""
    truths: dict[tuple[str, int, str], tuple[CameraTruth, list[str]]] = {}
    found = []
    for record in records:
        capture, camera = places[record.variant]
        if not _has_errors(record, _loader(cfg, capture, record.seed)):
            continue  # a result of other options, which overwrite=never has kept
        key = (record.scene, record.seed, capture)
        if key not in truths:
            dataset: DriftingDataset = instantiate(_loader(cfg, capture, record.seed))
            train = [view.name for view in dataset.outline(record.scene).scene.train]
            truths[key] = dataset.truth(record.scene), train
        one = compare(record, capture, camera, *truths[key])
        if one is not None:
            found.append(one)
    return found


def _has_errors(record: Record, loader: DictConfig) -> bool:
    """Whether a cell was trained on captures with the errors of this loader."""
    options = as_json(OmegaConf.to_container(loader))
    return all(record.setting(f"dataset.{name}") == options[name] for name in ("errors", "noise_degC", "seed"))

"""Records written by hand, and the published tables as records."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from PIL import Image

from tdgbench.cells.folder import hashes_below
from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.record import Record, read_each
from tdgbench.scenes.registry import DATASETS, SCENES
from tdgbench.tables.build import Tables
from tdgbench.tables.published import published_ablation, published_main


def record(**extra) -> Record:
    return Record("tdg", "synthetic", "orbit", "colmap", 0, "demo", extra.pop("variant", ""), **extra)


def write(experiment, method="tdg", scene="Truck", dataset="RGBT-Scenes", group="day", init="colmap", seed=0, **extra):
    record = Record(method, dataset, scene, init, seed, experiment.name, extra.pop("variant", ""), group=group)
    record.scores = {"psnr": 20.0, "ssim": 0.8, "lpips": 0.2, **extra.pop("scores", {})}
    record.seconds = {"train": 360.0}
    record.config = {"budget": {"name": "paper"}}
    return write_record(experiment, record, extra)


def write_record(experiment, record: Record, fields: dict[str, object]):
    """Write a record with these fields to its cell's folder, which is returned."""
    for name, value in fields.items():
        setattr(record, name, value)
    folder = cell_folder_of(experiment, record)
    folder.mkdir(parents=True)
    record.write(folder)
    return folder


def with_truth(experiment) -> None:
    """Give the cells the same small ground truth, and each a model of its own."""
    for folder, one in read_each(experiment):
        (folder / "targets").mkdir()
        Image.new("L", (4, 3), 9).save(folder / "targets" / "view.png")
        own = hashlib.sha256(f"{one.method} {one.seed} {one.scores} {one.data}".encode()).hexdigest()
        one.hashes = {"model.ply": own, **one.hashes, **hashes_below(folder)}
        one.write(folder)


def published_as_records(experiment, seed=0) -> None:
    values = published_main().set_index(["method", "scene", "metric"])["value"]
    for method in ("msmg", "tdg"):
        for s in SCENES:
            scores = {m: float(values[method, s.name, m]) for m in ("psnr", "ssim", "lpips")}
            hours = float(values[method, s.name, "train_hours"])
            write(
                experiment, method, s.name, DATASETS[s.dataset], s.group, seed=seed, scores=scores,
                seconds={"train": hours * 3600},
            )  # fmt: skip


def write_ablation(experiment) -> None:
    """The published ablation as records, with scores of training views and origins of points that the paper lacks."""
    values = published_ablation().set_index(["method", "init", "metric"])["value"]
    for method in ("msmg", "tdg"):
        for init in ("random", "colmap"):
            for s in SCENES:
                scores = {m: float(values[method, init, m]) for m in ("psnr", "ssim")}
                overfit = {"psnr": 40.0 if init == "random" else 30.0, "ssim": 0.9}
                points = {"how": "somewhere"} if init == "random" else {}
                write(
                    experiment, method, s.name, DATASETS[s.dataset], s.group, init, scores=scores, train_scores=overfit,
                    init_points=points,
                )  # fmt: skip


def without_cells(tables: Tables) -> Tables:
    """The tables with numbers alone: a report of them has no pictures."""
    return replace(tables, results=replace(tables.results, cells=[]))

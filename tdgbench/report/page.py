"""`report.html`: one file per experiment that opens from disk, with everything in it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from tdgbench.bench.cameras import read_cameras
from tdgbench.bench.paths import cell_folder_of
from tdgbench.bench.record import Record
from tdgbench.files import write_text
from tdgbench.report import views
from tdgbench.report.published import beside, section
from tdgbench.report.strip import place_name
from tdgbench.tables.build import ABLATION_KEYS, ABLATION_METRICS, Tables
from tdgbench.tables.readings import changes_as_text
from tdgbench.tables.results import METRICS, OVERALL, decimals, first_points, method_label, split_notes

FILE = "report.html"
TITLES = {
    "psnr": "PSNR ↑",
    "ssim": "SSIM ↑",
    "lpips": "LPIPS ↓",
    "hours": "time, h ↓",
    "train_psnr": "PSNR ↑, training views",
    "train_ssim": "SSIM ↑, training views",
    "rgb_psnr": "PSNR ↑, RGB model",
    "rgb_ssim": "SSIM ↑, RGB model",
}
CURVES = {"loss": "loss", "train_psnr": "PSNR of training views, dB", "gaussians": "Gaussians"}


@dataclass(frozen=True)
class Cell:
    """A finished cell and where it lies."""

    record: Record
    folder: Path

    @property
    def label(self) -> str:
        return method_label(self.record, with_init=True) + (f", seed {self.record.seed}" if self.record.seed else "")


def write_report(experiment: Path, tables: Tables) -> Path:
    """Write the page of an experiment from what is on disk; returns its path."""
    records = tables.records
    cells = [Cell(r, cell_folder_of(experiment, r)) for r in records if r.failure is None]
    scenes: dict[tuple[str, str, str], list[Cell]] = {}
    for cell in cells:
        scenes.setdefault((cell.record.dataset, cell.record.scene, cell.record.split), []).append(cell)
    environment = Environment(
        loader=PackageLoader("tdgbench.report", "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    html = environment.get_template("page.html.j2").render(
        name=experiment.resolve().name,
        table=_table(tables),
        published=section(tables, TITLES),
        changes=None if tables.effects is None else changes_as_text(tables.effects),
        scenes=[_scene(key[0], place_name(key, scenes), own) for key, own in scenes.items()],
        skips=[_skips(cell) for cell in cells],
        failures=[(r.title, r.failure.stage, r.failure.error) for r in records if r.failure is not None],
        environments=_environments(records),
    )
    path = experiment / FILE
    write_text(path, html)
    return path


def _table(tables: Tables) -> dict[str, Any]:
    """Columns, and rows of cells: text, value to sort by, whether bold, difference to the published number, verdict."""
    is_ablation = tables.kind == "ablation"
    keys = ABLATION_KEYS if is_ablation else ["method", "dataset", "scene", "metric"]
    published = {}
    if tables.difference is not None:
        published = {tuple(getattr(r, k) for k in keys): r for r in tables.difference.itertuples()}
    metrics = list(ABLATION_METRICS if is_ablation else METRICS)
    titles, rows = [TITLES[m] for m in metrics], []
    if not is_ablation:
        values = {tuple(getattr(r, k) for k in keys): r for r in tables.main.itertuples()}
        places = tables.main[["dataset", "scene", "method"]].drop_duplicates()
        by_scene = pd.Series(pd.factorize(places["dataset"] + "/" + places["scene"])[0], places.index)
        for place in places.loc[by_scene.sort_values(kind="stable").index].itertuples():  # in the main table's order
            own = [(place.method, place.dataset, place.scene, metric) for metric in metrics]
            rows.append(
                {
                    "head": [place.dataset, place.scene, place.method],
                    "cells": [_number(values[key], published.get(key)) for key in own],
                }
            )
        return {
            "heads": ["data set", "scene", "method"],
            "metrics": titles,
            "rows": rows,
            "notes": split_notes(tables.main),
        }
    for (method, init), own in tables.main.assign(scene=OVERALL).groupby(["method", "init"], sort=False):
        by_metric = {row.metric: row for row in own.itertuples()}
        cells = [_number(by_metric[m], published.get((method, init, m))) for m in metrics]
        rows.append({"head": [method, init], "cells": cells})
    heads, notes = ["method", "first points"], first_points(tables.main)
    return {"heads": heads, "metrics": titles, "rows": rows, "notes": notes}


def _number(row: Any, published: Any) -> dict[str, Any]:
    if np.isnan(row.value):
        return {"text": "n/a", "sort": "", "bold": False, "title": row.reason, "note": "", "verdict": ""}
    text = f"{row.value:.{decimals(row.metric, row.scene)}f}"
    std = getattr(row, "std", np.nan)
    if not np.isnan(std):
        text += f" ± {std:.{decimals(row.metric, row.scene)}f}"
    low, high = getattr(row, "low", np.nan), getattr(row, "high", np.nan)
    title = "" if np.isnan(low) else f"95 % over seeds and views: {low:.4g} to {high:.4g}"
    note, said = beside(published, row.scene)
    title = "; ".join(part for part in (said, title) if part)
    verdict = published.verdict if note else ""
    return {"text": text, "sort": row.value, "bold": bool(row.bold), "title": title, "note": note, "verdict": verdict}


def _scene(dataset: str, name: str, cells: list[Cell]) -> dict[str, Any]:
    """A scene's strip (the middle test view of each method's first cell) and the curves of all its cells."""
    first: dict[str, Cell] = {}
    for cell in cells:
        first.setdefault(method_label(cell.record, with_init=True), cell)
    names = sorted(p.stem for p in (next(iter(first.values())).folder / "renders").glob("*.png"))
    view = names[len(names) // 2]
    methods = [_method(label, cell, view) for label, cell in first.items()]
    temperature = next(iter(first.values())).record.temperature
    return {
        "dataset": dataset,
        "scene": name,
        "view": view,
        "truth": methods[0]["truth"],
        "methods": methods,
        "temperature": None if temperature is None else [f"{t:g}" for t in temperature],
        "ramp": views.embedded(views.colored(np.linspace(0, 1, 200)[None].repeat(8, 0), views.THERMAL, 0, 1)),
        "error_range": views.ERROR_RANGE,
        "curves": _curves(cells),
    }


def _method(label: str, cell: Cell, view: str) -> dict[str, Any]:
    truth_picture, truth = views.thermal(cell.folder / "targets" / f"{view}.png")
    picture, image = views.thermal(cell.folder / "renders" / f"{view}.png")
    depth, camera = views.depth_of(cell.folder, view)
    others = list(read_cameras(cell.folder / "cameras.json", "train").values())
    seen = views.coverage(depth, camera, others)
    known = depth[np.isfinite(depth)]
    low, high = np.quantile(known, [0.01, 0.99]) if len(known) else (0.0, 1.0)
    psnr = cell.record.scores.get("psnr")
    return {
        "label": label,
        "psnr": "n/a" if psnr is None else f"{psnr:.2f} dB",
        "truth": views.embedded(truth_picture),
        "render": views.embedded(picture),
        "error": views.embedded(views.error_map(image, truth)),
        "depth": views.embedded(views.colored(depth, views.DEPTH, low, high)),
        "depth_range": f"{low:.3g} to {high:.3g}",
        "coverage": views.embedded(views.colored(seen, views.COVERAGE, 0, len(others))),
        "train_views": len(others),
    }


def _curves(cells: list[Cell]) -> str:
    """Loss, PSNR and Gaussian counts along training, as SVG."""
    figure = Figure(figsize=(10, 2.6), layout="constrained")
    for axes, (column, title) in zip(figure.subplots(1, len(CURVES)), CURVES.items(), strict=True):
        for cell in cells:
            log = pd.read_csv(cell.folder / "log.csv")
            axes.plot(log["seconds"], log[column], linewidth=1, label=cell.label)
        axes.set_xlabel("seconds of training")
        axes.set_title(title, fontsize=9)
        axes.grid(linewidth=0.3)
    figure.axes[0].legend(fontsize=7)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]


def _skips(cell: Cell) -> dict[str, Any]:
    return {"title": cell.record.title, "skips": cell.record.skips}


def _environments(records: list[Record]) -> list[list[tuple[str, str]]]:
    """The different machines and versions that the cells ran on."""
    found = []
    for record in records:
        e = record.environment
        packages = ", ".join(f"{name} {version}" for name, version in e.get("packages", {}).items() if version)
        git = e.get("git") or {}
        commit = git.get("commit", "not from a checkout") + (" with changes" if git.get("dirty") else "")
        rows = [
            ("processor", f"{e.get('cpu')}, {e.get('cores')} cores, {e.get('threads')} threads"),
            ("GPU", ", ".join(f"{name} {value}" for name, value in (e.get("gpu") or {}).items()) or "none"),
            ("platform", f"{e.get('platform')}, Python {e.get('python')}"),
            ("packages", packages),
            ("commit", commit),
            ("metrics", record.convention),
        ]
        if rows not in found:
            found.append(rows)
    return found

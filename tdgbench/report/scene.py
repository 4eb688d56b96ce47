"""The report's part on one scene: pictures of a test view from every method, and training curves."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tdgbench.bench.cameras import read_cameras
from tdgbench.report import views
from tdgbench.tables import methods
from tdgbench.tables.cell import Cell
from tdgbench.tables.measures import measure
from tdgbench.tables.results import method_label

CURVES = {"loss": "loss", "train_psnr": "PSNR of training views, dB", "gaussians": "Gaussians"}


def scene_section(dataset: str, name: str, cells: list[Cell]) -> dict[str, Any]:
    """Pictures of the middle test view from each method's first cell, and the curves of all cells."""
    first: dict[str, Cell] = {}
    for cell in cells:
        first.setdefault(method_label(cell.record, with_init=True), cell)
    names = sorted(p.stem for p in (next(iter(first.values())).folder / "renders").glob("*.png"))
    view = names[len(names) // 2]
    strips = [_strip(methods.label(column), cell, view) for column, cell in first.items()]
    temperature = next(iter(first.values())).record.temperature
    return {
        "dataset": dataset,
        "scene": name,
        "view": view,
        "methods": strips,
        "temperature": None if temperature is None else [f"{t:g}" for t in temperature],
        "ramp": views.embedded(views.colored(np.linspace(0, 1, 200)[None].repeat(8, 0), views.THERMAL, 0, 1)),
        "error_range": views.ERROR_RANGE,
        "curves": _curves(cells),
    }


def _strip(label: str, cell: Cell, view: str) -> dict[str, Any]:
    truth_picture, truth = views.thermal(cell.folder / "targets" / f"{view}.png")
    picture, image = views.thermal(cell.folder / "renders" / f"{view}.png")
    depth, camera = views.depth_of(cell.folder, view)
    others = list(read_cameras(cell.folder / "cameras.json", "train").values())
    covered = views.coverage(depth, camera, others)
    known = depth[np.isfinite(depth)]
    low, high = np.quantile(known, [0.01, 0.99]) if len(known) else (0.0, 1.0)
    psnr, described = cell.record.scores.get("psnr"), measure("psnr")
    return {
        "label": label,
        "psnr": "n/a" if psnr is None else f"{psnr:.{described.digits}f}{described.suffix}",
        "truth": views.embedded(truth_picture),
        "render": views.embedded(picture),
        "error": views.embedded(views.colored(views.error_map(image, truth), views.ERROR, 0, views.ERROR_RANGE)),
        "depth": views.embedded(views.colored(depth, views.DEPTH, low, high)),
        "depth_range": f"{low:.3g} to {high:.3g}",
        "coverage": views.embedded(views.colored(covered, views.COVERAGE, 0, len(others))),
        "train_views": len(others),
    }


def _curves(cells: list[Cell]) -> str:
    """Loss, PSNR and number of Gaussians along training, as SVG."""
    figure = Figure(figsize=(10, 2.6), layout="constrained")
    logs = [(cell.label, pd.read_csv(cell.folder / "log.csv")) for cell in cells]
    for axes, (column, title) in zip(figure.subplots(1, len(CURVES)), CURVES.items(), strict=True):
        for label, log in logs:
            axes.plot(log["seconds"], log[column], linewidth=1, label=methods.label(label))
        axes.set_xlabel("seconds of training")
        axes.set_title(title, fontsize=9)
        axes.grid(linewidth=0.3)
    figure.axes[0].legend(fontsize=7)
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]

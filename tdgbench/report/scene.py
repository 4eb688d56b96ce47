"""The report's part on one scene: pictures of a test view from every method, and training curves."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from tdgbench.bench import masks
from tdgbench.bench.cameras import read_cameras
from tdgbench.report import views
from tdgbench.report.figures import any_font, plain
from tdgbench.tables import methods
from tdgbench.tables.cell import Cell
from tdgbench.tables.measures import measure
from tdgbench.tables.results import method_label

CURVES = {"loss": "loss", "train_psnr": "PSNR of training views, dB", "gaussians": "Gaussians"}


def scene_section(dataset: str, name: str, cells: list[Cell]) -> dict[str, Any]:
    """Return pictures of the middle test view from each method's first cell, and the curves of all cells.

    What cannot be read or drawn is n/a, with the reason in `problems`.
    """
    first: dict[str, Cell] = {}
    for cell in cells:
        first.setdefault(method_label(cell.record, with_init=True), cell)
    names = sorted({p.stem for cell in first.values() for p in (cell.folder / views.FILES.renders).glob("*.png")})
    view = names[len(names) // 2] if names else ""
    strips = [_Strip(cell, view) for cell in first.values()]
    curves = _Curves(cells)
    temperature = next(iter(first.values())).record.temperature
    return {
        "dataset": dataset,
        "scene": name,
        "view": view or "n/a",
        "methods": [strip.section(methods.label(column)) for strip, column in zip(strips, first, strict=True)],
        "masked": masks.masked_in_words(next(iter(first.values())).record.masked),
        "temperature": None if temperature is None else [f"{t:g}" for t in temperature],
        "ramp": views.embedded(views.colored(np.linspace(0, 1, 200)[None].repeat(8, 0), views.THERMAL, 0, 1)),
        "error_range": views.ERROR_RANGE,
        "curves": curves.svg(),
        "problems": [*(problem for strip in strips for problem in strip.problems), *curves.problems],
    }


class _Strip:
    """Pictures of one test view of a cell."""

    def __init__(self, cell: Cell, view: str) -> None:
        self.cell, self.view, self.problems = cell, view, list[str]()

    def section(self, label: str) -> dict[str, Any]:
        """Return pictures as data URIs, empty where they are n/a, and what is written below them."""
        psnr, described = self.cell.record.scores.get("psnr"), measure("psnr")
        shown = "n/a" if psnr is None else f"{psnr:.{described.digits}f}{described.suffix}"
        found = {
            "label": label, "psnr": shown,
            **dict.fromkeys(("truth", "render", "error", "depth", "coverage"), ""), "depth_range": "n/a",
            "train_views": "n/a",
        }  # fmt: skip
        for draw in (self._pictures, self._depth):
            try:
                found |= draw()
            except Exception as error:  # whatever is on disk, the page is written
                self.problems.append(f"{self.cell.record.title}: {error_text(error)}")
        return found

    def _pictures(self) -> dict[str, Any]:
        truth_picture, truth = views.thermal_picture(self.cell.folder / views.FILES.targets / f"{self.view}.png")
        picture, image = views.thermal_picture(self.cell.folder / views.FILES.renders / f"{self.view}.png")
        valid = views.stored_mask(self.cell.folder, self.view, truth.shape)
        error = views.colored(views.error_map(image, truth, valid), views.ERROR, 0, views.ERROR_RANGE)
        return {
            "truth": views.embedded(views.grayed(truth_picture, valid)), "render": views.embedded(picture),
            "error": views.embedded(error),
        }  # fmt: skip

    def _depth(self) -> dict[str, Any]:
        depth, camera = views.depth_of(self.cell.folder, self.view)
        others = list(read_cameras(self.cell.folder)["train"].values())
        covered = views.coverage(depth, camera, others)
        known = depth[np.isfinite(depth)]
        low, high = np.quantile(known, [0.01, 0.99]) if len(known) else (0.0, 1.0)
        return {
            "depth": views.embedded(views.colored(depth, views.DEPTH, low, high)),
            "depth_range": f"{low:.3g} to {high:.3g}",
            "coverage": views.embedded(views.colored(covered, views.COVERAGE, 0, len(others))),
            "train_views": len(others),
        }


class _Curves:
    """Loss, PSNR and number of Gaussians along the training of cells."""

    def __init__(self, cells: list[Cell]) -> None:
        self.problems: list[str] = []
        self.logs: list[tuple[str, pd.DataFrame]] = []
        for cell in cells:
            log = cell.log()
            if log is None or not {"seconds", *CURVES} <= set(log.columns):
                self.problems.append(f"{cell.record.title}: log.csv is missing or no log, so its curves are n/a")
            else:
                self.logs.append((cell.label, log))

    def svg(self) -> str:
        """Return the curves as SVG."""
        figure = Figure(figsize=(10, 2.6), layout="constrained")
        for axes, (column, title) in zip(figure.subplots(1, len(CURVES)), CURVES.items(), strict=True):
            for label, log in self.logs:
                axes.plot(log["seconds"], log[column], linewidth=1, label=plain(methods.label(label)))
            axes.set_xlabel("seconds of training")
            axes.set_title(title, fontsize=9)
            axes.grid(linewidth=0.3)
        if self.logs:
            figure.axes[0].legend(fontsize=7)
        buffer = io.StringIO()
        with any_font():
            figure.savefig(buffer, format="svg", metadata={"Date": None})
        text = buffer.getvalue()
        return text[text.index("<svg") :]


def error_text(error: Exception) -> str:
    """Return an error in words, for the page.

    >>> error_text(ValueError("it is a FIFO")), error_text(KeyError("a"))
    ('it is a FIFO', "KeyError: 'a'")
    """
    return str(error) if isinstance(error, (ValueError, OSError)) else f"{type(error).__name__}: {error}"

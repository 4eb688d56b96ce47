"""The report's part on one scene: pictures of a test view from every method, and training curves."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from tdgbench.bench.failures import message
from tdgbench.cells.ground_truth import masked_in_words
from tdgbench.present.colours import THERMAL, colored, in_colour, shaded
from tdgbench.present.figures import any_font, plain
from tdgbench.present.html import embedded
from tdgbench.present.view_pictures import DEPTH, ERROR_RANGE, middle_view, rendered_depth, view_pictures
from tdgbench.scoring.metrics.seen_pixels import is_barely_seen
from tdgbench.tables import methods
from tdgbench.tables.assumptions import assumed_rows
from tdgbench.tables.long_table import method_label
from tdgbench.tables.measures import MEASURES
from tdgbench.tables.results import Cell

CURVES = {"loss": "loss", "smoothed_psnr": "PSNR of training renders, dB", "gaussians": "Gaussians"}


def scene_section(dataset: str, name: str, cells: list[Cell]) -> dict[str, Any]:
    """Return pictures of the middle test view from each method's first cell, and the curves of all cells.

    What cannot be read or drawn is n/a, with the reason in `problems`.
    """
    first: dict[str, Cell] = {}
    for cell in cells:
        first.setdefault(method_label(cell.record, with_init=True), cell)
    view, problems = middle_view(first.values()), list[str]()
    shown = [method_section(cell, view, methods.label(column), problems) for column, cell in first.items()]
    record = next(iter(first.values())).record
    return {
        "dataset": dataset,
        "scene": name,
        "view": view or "n/a",
        "methods": shown,
        "assumed": assumed_rows([(methods.label(cell.label), cell.record) for cell in cells]),
        "masked": masked_in_words(record.masked),
        "temperature": None if record.temperature_range is None else [f"{t:g}" for t in record.temperature_range],
        "ramp": embedded(colored(np.linspace(0, 1, 200)[None].repeat(8, 0), THERMAL, 0, 1)),
        "error_range": ERROR_RANGE,
        "curves": curves_as_svg(cells, problems),
        "problems": problems,
    }


def method_section(cell: Cell, view: str, label: str, problems: list[str]) -> dict[str, Any]:
    """Return pictures of a test view as data URIs, empty where they are n/a, and what is written below them."""
    shown = {
        **dict.fromkeys(("truth", "render", "error", "depth", "guesses"), ""),
        **dict.fromkeys(("depth_range", "barely_seen"), "n/a"),
        "label": label,
        "psnr": MEASURES["psnr"].as_text(cell.record.scores.get("psnr")),
    }
    only_images = cell.record.made_elsewhere is not None and not cell.record.gaussians
    for draw in (_pictures,) if only_images else (_pictures, _depth, _guesses):
        try:
            shown |= draw(cell, view)
        except Exception as error:  # whatever is on disk, the page is written
            problems.append(f"{cell.record.title}: {message(error)}")
    return shown


def _pictures(cell: Cell, view: str) -> dict[str, Any]:
    pictures = view_pictures(cell, view)
    return {name: embedded(getattr(pictures, name)) for name in ("truth", "render", "error")}


def _depth(cell: Cell, view: str) -> dict[str, Any]:
    depth = rendered_depth(cell, view)
    known = depth[np.isfinite(depth)]
    low, high = np.quantile(known, [0.01, 0.99]) if len(known) else (0.0, 1.0)
    return {"depth": embedded(colored(depth, DEPTH, low, high)), "depth_range": f"{low:.3g} to {high:.3g}"}


def _guesses(cell: Cell, view: str) -> dict[str, Any]:
    render, determinacy = cell.pictures(view).render, cell.determinacy(view)
    return {
        "guesses": embedded(shaded(in_colour(render), determinacy)),
        "barely_seen": f"{is_barely_seen(determinacy).mean():.0%}",
    }


def curves_as_svg(cells: list[Cell], problems: list[str]) -> str:
    """Return loss, PSNR and number of Gaussians along each cell's training, as SVG; unreadable logs are n/a."""
    figure = Figure(figsize=(10, 2.6))
    panels = figure.subplots(1, len(CURVES))
    figure.subplots_adjust(left=0.07, right=0.99, bottom=0.17, top=0.9, wspace=0.3)
    for cell in cells:
        if cell.record.made_elsewhere is not None:
            continue
        log = cell.log
        if log is None or not {"seconds", *CURVES} <= set(log.columns):
            problems.append(f"{cell.record.title}: log.csv is missing or no log, so its curves are n/a")
            continue
        for axes, column in zip(panels, CURVES, strict=True):
            axes.plot(log["seconds"], log[column], linewidth=1, label=plain(methods.label(cell.label)))
    for axes, title in zip(panels, CURVES.values(), strict=True):
        axes.set_xlabel("seconds of training")
        axes.set_title(title, fontsize=9, y=1.0)
        axes.grid(linewidth=0.3)
    if panels[0].lines:
        panels[0].legend(fontsize=7)
    buffer = io.StringIO()
    with any_font():
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]

"""The report's part on one scene: a test view of every method, errors, depth, and training curves."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tdgbench.bench.failures import message
from tdgbench.cells.folder import RENDERS, CellPictures
from tdgbench.cells.ground_truth import masked_in_words
from tdgbench.present.colour_scale import ColourScale
from tdgbench.present.colours import GUESSED, LEVELS, MIN_ALPHA, THERMAL, UNKNOWN, colored, colours_of_levels
from tdgbench.present.html import filter_tables
from tdgbench.present.view_pictures import DEPTH, ERROR, middle_view, rendered_depth, scale_of
from tdgbench.report.panels import curve_panels, error_panel, line_colours, settling_panel
from tdgbench.scenes.registry import LABELS
from tdgbench.scoring.metrics.barely_seen import is_barely_seen
from tdgbench.tables import methods
from tdgbench.tables.assumptions import assumed_rows
from tdgbench.tables.cell_names import cell_title
from tdgbench.tables.likeness import was_disturbed
from tdgbench.tables.long_table import method_label
from tdgbench.tables.measures import measure_of
from tdgbench.tables.results import Cell


@dataclass
class ShownCell:
    """A method's first cell with what is drawn of it; None where it is n/a. depth, determinacy: (H, W).

    errors: how many pixels of the test views have a render of -255 to 255 levels above the truth, (511,).
    """

    cell: Cell
    label: str
    pictures: CellPictures
    psnr: float | None
    depth: np.ndarray | None
    determinacy: np.ndarray | None
    errors: np.ndarray | None


def scene_section(
    dataset: str, name: str, cells: Sequence[Cell], colours: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return pictures of the middle test view from each method's first cell, and the curves of all cells.

    cells: methods in the order of the tables. colours: of curves, by column. What cannot be read or drawn is n/a,
    with the reason in `problems`. Methods whose ground truth differs, as with another width, are shown apart.
    """
    first: dict[str, Cell] = {}
    for cell in cells:
        first.setdefault(method_label(cell.record, with_init=True), cell)
    colours = colours or line_colours(first)
    view, problems = middle_view(first.values()), list[str]()
    groups: dict[tuple[object, ...], list[ShownCell]] = {}
    for column, cell in first.items():
        shown = _shown(cell, view, methods.label(column), problems)
        if shown is not None:
            truth, _, valid = shown.pictures
            span = tuple(cell.record.temperature_range or ())
            key = truth.shape, truth.tobytes(), None if valid is None else valid.tobytes(), span
            groups.setdefault(key, []).append(shown)
    record = next(iter(first.values())).record
    return {
        "dataset": dataset,
        "scene": LABELS.get(name, name),
        "view": view or "n/a",
        "views": len(next(iter(first.values())).views_with(RENDERS)),
        "groups": [_group(group, colours) for group in groups.values()],
        "assumed": assumed_rows([(cell.label, cell.record) for cell in cells]),
        "masked": masked_in_words(record.masked),
        "curves": curve_panels(cells, colours, problems),
        "busy": any(was_disturbed(cell.record) for cell in cells),
        "settling": settling_panel(cells, colours),
        "problems": problems,
    }


def _shown(cell: Cell, view: str, label: str, problems: list[str]) -> ShownCell | None:
    """Return what is drawn of a cell; None, and a problem, where its pictures are unusable."""
    of_gaussians = bool(cell.record.gaussians)

    def tried(read: Callable[[], Any], wanted: bool = True) -> Any:
        try:
            return read() if wanted else None
        except Exception as error:  # whatever is on disk, the page is written
            problems.append(f"{cell_title(cell.record)}: {message(error)}")
            return None

    pictures = tried(lambda: cell.pictures(view))
    if pictures is None:
        return None
    return ShownCell(
        cell, f"{label}, seed {cell.record.seed}", pictures,
        psnr=tried(lambda: cell.read_views().get(view, {}).get("psnr")),
        depth=tried(lambda: rendered_depth(cell, view), cell.has_model),
        determinacy=tried(lambda: cell.determinacy(view), of_gaussians),
        errors=tried(lambda: error_counts(cell.pictures(name) for name in cell.views_with(RENDERS)),
                     cell.record.temperature_range is not None),
    )  # fmt: skip


def error_counts(views: Iterable[CellPictures]) -> np.ndarray:
    """Return how many valid pixels have a render of -255 to 255 levels above the truth, (511,).

    >>> view = CellPictures(np.uint8([[[7], [9]]]), np.uint8([[[6], [9]]]), np.array([[True, True]]))
    >>> np.flatnonzero(error_counts([view])).tolist()
    [254, 255]
    """
    counts = np.zeros(2 * LEVELS - 1, np.int64)
    for truth, render, valid in views:
        difference = (render.astype(int) - truth)[..., 0] + LEVELS - 1
        counts += np.bincount(difference[... if valid is None else valid].ravel(), minlength=len(counts))
    return counts


def _group(shown: Sequence[ShownCell], colours: Mapping[str, str]) -> dict[str, Any]:
    """Return the pictures of methods with one ground truth, on one scale, (H, W, C) uint8; None where they are n/a."""
    truth, _, valid = shown[0].pictures
    span = shown[0].cell.record.temperature_range
    scale = scale_of([(one.pictures, span) for one in shown])
    with_errors = [(one, one.errors) for one in shown if one.errors is not None and one.errors.any()]
    depths = [one.depth[np.isfinite(one.depth)] for one in shown if one.depth is not None]
    known = np.concatenate(depths) if depths else np.empty(0)
    near, far = np.quantile(known, [0.01, 0.99]) if len(known) else (0.0, 1.0)
    return {
        "truth": truth,
        "mask": None if valid is None else np.dstack([np.full((*valid.shape, 3), UNKNOWN), 255 * ~valid]),
        "scale": scale,
        "tables": _tables(scale, truth.shape[2] == 1),
        "ramp": np.arange(LEVELS, dtype=np.uint8)[None].repeat(8, 0)[..., None] if scale.ends else None,
        "size": f"{truth.shape[1]}×{truth.shape[0]} px",
        "depth_range": f"{near:.3g} to {far:.3g}" if len(known) else "n/a",
        "methods": [_pictures(one, near, far) for one in shown],
        "errors": None if span is None else error_panel(
            {one.label: errors for one, errors in with_errors}, span,
            [colours[method_label(one.cell.record, with_init=True)] for one, _ in with_errors],
        ),
    }  # fmt: skip


def _tables(scale: ColourScale, is_gray: bool) -> dict[str, list[str]]:
    """Return tables of the page's filters that colour stored levels: of values, of a whole ramp, of differences."""
    error = colours_of_levels(ERROR, 0, scale.error)
    if not is_gray:
        return {"error": filter_tables(error)}
    values, ramp = colours_of_levels(THERMAL, scale.low, scale.high), colours_of_levels(THERMAL, 0, 1)
    return {"values": filter_tables(values), "ramp": filter_tables(ramp), "error": filter_tables(error)}


def _share(share: float) -> str:
    return "< 1 %" if 0 < share < 0.005 else f"{100 * share:.0f} %"


def _pictures(one: ShownCell, near: float, far: float) -> dict[str, Any]:
    known, guesses = one.determinacy, None
    if known is not None:
        guesses = np.dstack([np.full((*known.shape, 3), GUESSED), (255 * (1 - known) + 0.5).astype(np.uint8)])
    return {
        "label": one.label,
        "psnr": measure_of("psnr").as_text(one.psnr),
        "render": one.pictures.render,
        "depth": None if one.depth is None else colored(one.depth, DEPTH, near, far),
        "has_gaps": one.depth is not None and bool(np.isnan(one.depth).any()),
        "guesses": guesses,
        "least_alpha": MIN_ALPHA,
        "barely_seen": "n/a" if known is None else _share(is_barely_seen(known).mean()),
    }

"""`compare.html`: the comparison with pictures, one file that opens from disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.compare.causes import KINDS, Cause
from tdgbench.compare.compared_cells import FIRST, ComparedCell, Pairs, comparison_grid
from tdgbench.files import write_text
from tdgbench.packs.write import without_paths
from tdgbench.present.colours import colored, in_colour
from tdgbench.present.html import embedded, environment
from tdgbench.present.view_pictures import ERROR, ERROR_RANGE
from tdgbench.tables.assumptions import AssumedDifference, assumed_rows
from tdgbench.terminal import printable

MOST_PICTURES = 24  # of cells, so that a page stays some megabytes


def write_page(
    path: Path,
    names: tuple[str, str],
    findings: Sequence[str],
    table: pd.DataFrame,
    causes: Sequence[Cause],
    pairs: Pairs,
    otherwise: Sequence[AssumedDifference],
) -> None:
    """Write the page. names: of A and B. table: from `score_table`. otherwise: what was assumed in another way."""
    shown = [(place, min(seeds.items())) for place, seeds in pairs.by_place.items()]
    pages, is_first = environment("tdgbench.compare"), table["metric"].isin(FIRST)
    pages.finalize = _public
    html = pages.get_template("comparison_page.html.j2").render(
        a=names[0], b=names[1], findings=findings,
        causes=[(kind, meaning, [cause.sentence(len(pairs)) for cause in causes if cause.kind == kind])
                for kind, meaning in KINDS.items()],
        otherwise=[one.sentence for one in otherwise], assumed=_assumed(pairs),
        scores=comparison_grid(table[is_first]), others=comparison_grid(table[~is_first]),
        pictures=[picture(", ".join(filter(None, place)) + f", seed {seed}", pair)
                  for place, (seed, pair) in shown[:MOST_PICTURES]],
    )  # fmt: skip
    write_text(path, html)


def _public(value: Any) -> Any:
    """Return what a page prints: text without paths of a machine, and a picture as it is."""
    if type(value) is not str or value.startswith("data:"):
        return value
    return printable(without_paths(value))


def _assumed(pairs: Pairs) -> dict[str, list[tuple[str, str]]]:
    """Return what was assumed of the files of each scene, by its name: once where A and B agree."""
    scenes: dict[str, list[tuple[str, Record]]] = {}
    for pair in pairs:
        place = f"{pair.a.record.dataset}/{pair.a.record.scene}"
        scenes.setdefault(place, []).extend((("A", pair.a.record), ("B", pair.b.record)))
    return {scene: assumed_rows(cells) for scene, cells in scenes.items()}


def picture(title: str, pair: ComparedCell) -> dict[str, object]:
    """Return the pictures of the test view whose PSNR differs most between the two cells of a pair."""
    view = ""
    try:
        view = _most_different(pair)
        a, b = (cell.pictures(view) for cell in pair)
        if a.render.shape != b.render.shape:
            raise ValueError(f"the renders have {a.render.shape[:2]} and {b.render.shape[:2]} pixels")
    except (OSError, ValueError) as error:
        return {"title": title, "view": view, "problem": str(error)}
    difference = np.abs(a.render.astype(float) - b.render).mean(axis=2) / 255
    images = {"a": a.render, "b": b.render, "truth": a.truth}
    return {
        "title": title, "view": view, "problem": "", "range": ERROR_RANGE,
        **{name: embedded(in_colour(pixels)) for name, pixels in images.items()},
        "difference": embedded(colored(difference, ERROR, 0, ERROR_RANGE)),
    }  # fmt: skip


def _most_different(pair: ComparedCell) -> str:
    tables = [table["psnr"] for table in (cell.views for cell in pair) if table is not None]
    if len(tables) < 2:
        raise ValueError("views.csv is missing or unusable")
    a, b = tables
    common = (a - b).abs().dropna()
    if common.empty:
        raise ValueError("no test view has a PSNR in both")
    return str(common.idxmax())

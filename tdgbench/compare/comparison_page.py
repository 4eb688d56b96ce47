"""`compare.html`: the comparison with pictures, one file that opens from disk."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from tdgbench.cells.folder import CellPictures
from tdgbench.cells.record import Record
from tdgbench.compare.causes import KINDS, Cause
from tdgbench.compare.compared_cells import FIRST, comparison_grid, legend
from tdgbench.compare.pairs import ComparedCell, Pairs
from tdgbench.files import write_text
from tdgbench.present.colour_scale import colour_scale
from tdgbench.present.colours import colored, in_colour
from tdgbench.present.html import embedded, environment
from tdgbench.present.view_pictures import ERROR, grayed
from tdgbench.tables.assumptions import AssumedDifference, assumed_rows

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
    is_first = table["metric"].isin(FIRST)
    html = environment("tdgbench.compare").get_template("comparison_page.html.j2").render(
        a=names[0], b=names[1], findings=findings,
        causes=[(kind, meaning, [cause.sentence(len(pairs)) for cause in causes if cause.kind == kind])
                for kind, meaning in KINDS.items()],
        otherwise=[one.sentence for one in otherwise], assumed=_assumed(pairs),
        scores=comparison_grid(table[is_first], findings), others=comparison_grid(table[~is_first], findings),
        legend=legend(table),
        pictures=[picture(", ".join(filter(None, place)) + f", seed {seed}", pair)
                  for place, (seed, pair) in shown[:MOST_PICTURES]],
        pictures_left_out=max(0, len(shown) - MOST_PICTURES),
    )  # fmt: skip
    write_text(path, html)


def _assumed(pairs: Pairs) -> dict[str, list[tuple[str, str]]]:
    """Return what was assumed of the files of each scene, by its name: once where A and B agree."""
    scenes: dict[str, list[tuple[str, Record]]] = {}
    for pair in pairs:
        place = f"{pair.a.record.dataset}/{pair.a.record.scene}"
        scenes.setdefault(place, []).extend((("A", pair.a.record), ("B", pair.b.record)))
    return {scene: assumed_rows(cells) for scene, cells in scenes.items()}


def picture(title: str, pair: ComparedCell) -> dict[str, object]:
    """Return the pictures of the test view whose PSNR differs most between the two cells of a pair, on one scale."""
    view = ""
    try:
        view = _most_different(pair)
        a, b = (cell.pictures(view) for cell in pair)
        if a.render.shape != b.render.shape:
            sizes = ("×".join(map(str, (width, height, *channels)))
                     for height, width, *channels in (a.render.shape, b.render.shape))  # fmt: skip
            raise ValueError(f"the renders have {' and '.join(sizes)} values")
        if pair.a.record.temperature_range != pair.b.record.temperature_range:
            raise ValueError("their values span other temperatures, so that no scale of colours holds for both")
    except (OSError, ValueError) as error:
        return {"title": title, "view": view, "problem": str(error)}
    difference = CellPictures(a.render, b.render, a.valid).error
    scale = colour_scale(a.truth, a.valid, pair.a.record.temperature_range, difference)
    images = {
        name: grayed(in_colour(pixels, scale.low, scale.high), a.valid)
        for name, pixels in (("a", a.render), ("b", b.render), ("truth", a.truth))
    }
    return {
        "title": title, "view": view, "problem": "", "scale": scale,
        **{name: embedded(pixels) for name, pixels in images.items()},
        "difference": embedded(colored(difference, ERROR, 0, scale.error)),
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

"""Tables as LaTeX (booktabs), with the paper's rows, groups and bold."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from typing import NamedTuple

import numpy as np
import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.present.grid import Grid, GridCell, GridRow
from tdgbench.scenes.registry import GROUPS, LABELS, is_built_in
from tdgbench.scoring.metric import Measure
from tdgbench.tables import methods
from tdgbench.tables.grids import ERROR, reasons_for_na
from tdgbench.tables.likeness import NOT_COMPARED
from tdgbench.tables.long_table import (
    RANGE,
    initial_points,
    is_random,
    protocol_notes,
)
from tdgbench.tables.measures import ABLATION, ABLATION_PAIRS, AVERAGE, HOURS, MAIN_COLUMNS, OVERALL, digits, measure_of
from tdgbench.tables.palette import MARK
from tdgbench.tables.setup_notes import setup_notes
from tdgbench.text import one_line

ESCAPES = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}", '"': "''", "…": r"\ldots{}", "–": "--", "—": "---",
    "→": r"$\to$", "±": r"$\pm$", "×": r"$\times$", "−": "$-$", "°": r"$^\circ$", "’": "'", "\N{NO-BREAK SPACE}": "~",
}  # fmt: skip
KNOWN_TO_PDFLATEX = range(0xC0, 0x100)  # accented letters of Latin-1, but for those that need another font encoding
NEED_T1 = "ÐÞðþ÷"
LATEX_MARK = r"$^\dagger$"


def escape(text: str) -> str:
    r"""Escape text for LaTeX, in one line. What pdflatex cannot print is given by its number.

    >>> print(escape("50 % of a_b"), escape("[a]"), escape("é 熱"))
    50 \% of a\_b {[}a] é \texttt{U+71B1}
    """
    escaped = "".join(_escaped(c) for c in text)
    # a bracket or star would be an argument of the `\\\\` before it
    return f"{{{escaped[0]}}}{escaped[1:]}" if escaped[:1] in ("[", "*") else escaped


def _escaped(c: str) -> str:
    if c in ESCAPES:
        return ESCAPES[c]
    if (c.isascii() and c.isprintable()) or (ord(c) in KNOWN_TO_PDFLATEX and c not in NEED_T1):
        return c
    return " " if c.isspace() else rf"\texttt{{U+{ord(c):04X}}}"


def tabular(
    columns: str, heads: Sequence[str], body: Sequence[str], notes: Sequence[str] = (), below: Sequence[str] = ()
) -> str:
    r"""Return a `tabular`, which needs the package booktabs. heads, body: lines. notes: comments before it.

    below: notes that are printed below the table.

    >>> print(tabular("lr", ["& PSNR \\\\"], [r"\midrule", "a & 24.1 \\\\"]), end="")
    \begin{tabular}{lr}
    \toprule
    & PSNR \\
    \midrule
    a & 24.1 \\
    \bottomrule
    \end{tabular}
    """
    begin = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule"]
    wrapped = rf"\multicolumn{{{len(columns)}}}{{p{{\linewidth}}}}"
    lines = [rf"{wrapped}{{{{\footnotesize\raggedright {_below(note)}\par}}}} \\" for note in below]
    notes = [f"% {one_line(note)}" for note in notes]
    return "\n".join([*notes, *begin, *heads, *body, r"\bottomrule", *lines, r"\end{tabular}", ""])


def _below(note: str) -> str:
    if note == NOT_COMPARED:
        note = "Columns of unlike trainings are not compared."
    return (LATEX_MARK if note.startswith(MARK) else "") + escape(note.removeprefix(MARK))


def main_table(main: pd.DataFrame, grid: Grid, columns: Sequence[str] = (), records: Sequence[Record] = ()) -> str:
    """Return a standalone `tabular` of scenes down, methods × measures across; it needs the package booktabs.

    grid: `main_grid` of the main table. columns: measures; by default those of the paper, and the error in °C beside
    PSNR where the grid has it. records: of the finished cells.
    """
    measures = [name for name in grid.names if name in (columns or (*MAIN_COLUMNS, ERROR))]
    labels = list(dict.fromkeys(row.place[2] for row in grid.rows))
    at, width = [grid.names.index(name) for name in measures], 1 + len(labels) * len(measures)
    unit = _time_unit([cell for row in grid.rows for name, cell in zip(grid.names, row.cells, strict=True)
                       if name == HOURS.name])  # fmt: skip
    lines, before = [], ("", "")
    for (dataset, scene), rows in _by_scene(grid).items():
        group = rows[labels[0]].group
        if scene == OVERALL:
            lines.append(r"\midrule")
        elif dataset != before[0]:
            title = f"Built-in scenes ({dataset})" if is_built_in(dataset) else dataset
            lines += [r"\midrule", rf"\multicolumn{{{width}}}{{l}}{{\textbf{{{escape(title)}}}}} \\"]
        if group and (dataset, group) != before and not is_built_in(dataset):
            title = escape(GROUPS.get(group, group))
            lines.append(rf"\multicolumn{{{width}}}{{l}}{{\quad\textbf{{{title}}}}} \\")
        before = dataset, group
        mark = LATEX_MARK if any(row.is_marked for row in rows.values()) else ""
        values = [_number(rows[m].cells[i], grid.names[i], scene, unit) for m in labels for i in at]
        lines.append(f"{_row_title(scene)}{_range(rows.values(), grid)}{mark} & {' & '.join(values)} \\\\")
    comments = protocol_notes(main)
    notes = [*grid.notes, *reasons_for_na(main, measures), *setup_notes(records, HOURS.name in measures)]
    below = [note for note in notes if note not in comments]
    return tabular("l" + "c" * (width - 1), _heads(labels, measures, unit), lines, comments, below)


def ablation_table(main: pd.DataFrame, grid: Grid, records: Sequence[Record] = ()) -> str:
    """Return a `tabular` as the paper's Table 2: methods × inits down, PSNR / SSIM of views and models across.

    Several kinds of random points are named, and points that are neither. grid: `ablation_grid` of the ablation.
    records: of the finished cells.
    """
    several = sum(map(is_random, {row.place[1] for row in grid.rows})) > 1
    parts = " & ".join(measure_of(psnr).images or "PSNR / SSIM" for psnr, _ in ABLATION_PAIRS)
    lines = []
    for method, rows in groupby(grid.rows, key=lambda row: row.place[0]):
        lines.append(r"\midrule")
        for row in rows:
            init, cells = row.place[1], dict(zip(ABLATION, row.cells, strict=True))
            kind = init.removeprefix("random").strip("_") or "cameras"
            named_random = f" ({escape(kind)})" if several else ""
            colmap = r"$\checkmark$" if init == "colmap" else rf"$\times$ ({escape(init)})"
            marks = rf"$\checkmark${named_random} & $\times$" if is_random(init) else rf"$\times$ & {colmap}"
            pairs = " & ".join(_pair(cells, names) for names in ABLATION_PAIRS)
            mark = LATEX_MARK if row.is_marked else ""
            lines.append(f"{escape(methods.label(method))}{mark} & {marks} & {pairs} \\\\")
    heads = [rf" & Random & COLMAP & {parts} \\"]
    comments = initial_points(main)
    below = [note for note in (*grid.notes, *setup_notes(records, timed=False)) if note not in comments]
    return tabular("lcc" + "c" * len(ABLATION_PAIRS), heads, lines, comments, below)


def _heads(labels: Sequence[str], measures: Sequence[str], unit: TimeUnit) -> list[str]:
    """Return the lines of the main table's head: methods, each over its measures."""
    count = len(measures)
    titles = [rf"\multicolumn{{{count}}}{{c}}{{{escape(methods.label(m))}}}" for m in labels]
    rules = [rf"\cmidrule(lr){{{2 + i * count}-{1 + (i + 1) * count}}}" for i in range(len(labels))]
    names = [rf"Time [{unit.name}] $\downarrow$" if m == HOURS.name else _title(measure_of(m)) for m in measures]
    return [f"Scene & {' & '.join(titles)} \\\\", "".join(rules), f" & {' & '.join(names * len(labels))} \\\\"]


def _title(measure: Measure) -> str:
    """Return a measure's heading; those without one of LaTeX have that of the terminal."""
    label = measure.label + (f", {measure.images}" if measure.images else "") + ", °C" * (measure.unit == "°C")
    return replace(measure, latex=measure.latex or escape(label)).latex_column


class TimeUnit(NamedTuple):
    """A unit that times are printed in. hours: that it has."""

    name: str
    hours: float
    digits: int


UNITS = (TimeUnit("h", 1, HOURS.digits), TimeUnit("min", 1 / 60, 1), TimeUnit("s", 1 / 3600, 1))


def _time_unit(cells: Sequence[GridCell]) -> TimeUnit:
    """Return the unit of a table's times: hours beside published ones, else the largest that is no longer than any."""
    shortest = min((cell.value for cell in cells if not np.isnan(cell.value)), default=1.0)
    if any(cell.published for cell in cells):
        return UNITS[0]
    return next((unit for unit in UNITS if shortest >= unit.hours), UNITS[-1])


def _range(rows: Iterable[GridRow], grid: Grid) -> str:
    """Return ` (10 to 35 °C)` of a scene in °C, on which its PSNR depends; empty for others."""
    spans = {row.cells[grid.names.index(RANGE)].text for row in rows} - {"n/a"} if RANGE in grid.names else set[str]()
    return f" ({escape(', '.join(sorted(spans)))} $^\\circ$C)" if spans else ""


def _by_scene(grid: Grid) -> dict[tuple[str, str], dict[str, GridRow]]:
    """Return the rows of a main table by data set and scene, then method: scenes of a group together, then averages."""
    by_scene: dict[tuple[str, str], dict[str, GridRow]] = {}
    for row in grid.rows:
        by_scene.setdefault((row.place[0], row.place[1]), {})[row.place[2]] = row
    nth_dataset = {dataset: i for i, dataset in enumerate(dict.fromkeys(dataset for dataset, _ in by_scene))}
    groups = dict.fromkeys((row.place[0], row.group) for row in grid.rows if row.place[1] != AVERAGE)
    nth_group = {place: i for i, place in enumerate(groups)}

    def position(place: tuple[str, str]) -> tuple[bool, int, bool, int]:
        group = next(iter(by_scene[place].values())).group
        return place[1] == OVERALL, nth_dataset[place[0]], place[1] == AVERAGE, nth_group.get((place[0], group), 0)

    return {place: by_scene[place] for place in sorted(by_scene, key=position)}


def _row_title(scene: str) -> str:
    titles = {AVERAGE: r"\quad\textbf{Average}", OVERALL: r"\textbf{Average (Overall)}"}
    return titles.get(scene) or rf"\qquad {escape(LABELS.get(scene, scene))}"


def _pair(cells: Mapping[str, GridCell], names: Sequence[str]) -> str:
    """Return PSNR / SSIM of a model and its views."""
    return " / ".join(_number(cells[name], name, OVERALL) for name in names)


def _number(cell: GridCell, metric: str, scene: str, unit: TimeUnit = UNITS[0]) -> str:
    if np.isnan(cell.value):
        return "n/a"
    per, places = (unit.hours, unit.digits) if metric == HOURS.name else (1.0, digits(metric, scene))
    text = f"{cell.value / per:.{places}f}"
    spread = "" if np.isnan(cell.std) else rf" $\pm$ {cell.std / per:.{places}f}"
    return (rf"\textbf{{{text}}}" if cell.bold else text) + spread

"""What the viewer says in words: values under the cursor, a colour bar, a record's numbers. As HTML, text escaped."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import timedelta
from html import escape

import numpy as np

from tdgbench.scoring import METRICS
from tdgbench.view.cells import ViewedCell
from tdgbench.view.paint import lookup_table
from tdgbench.view.renderer import RenderedLook

STOPS = 12  # colours of a colour bar
STYLE = "font-size:0.8em;padding:0 0.75em 0.5em"


def value_text(values: np.ndarray, quantity: str, degC: tuple[float, float] | None) -> str:
    """Return one pixel's values (C,) in words. degC: temperatures of the image values 0 and 1, if they are known.

    >>> value_text(np.array([0.5]), "thermal", (20.0, 30.0)), value_text(np.array([0.5]), "thermal", None)
    ('25.0 °C', '0.500')
    >>> value_text(np.array([np.nan]), "depth", None), value_text(np.array([0.1, 0.2, 1.0]), "rgb", None)
    ('no surface', '0.100 0.200 1.000')
    >>> value_text(np.array([2.5]), "depth", None)
    'z 2.500'
    """
    if not np.isfinite(values).all():
        return "no surface"
    if quantity == "thermal" and len(values) == 1 and degC is not None:
        return f"{degC[0] + float(values[0]) * (degC[1] - degC[0]):.1f} °C"
    text = " ".join(f"{value:.3f}" for value in values)
    return f"z {text}" if quantity == "depth" else text


def readout(shown: list[tuple[str, np.ndarray]], cells: Mapping[str, ViewedCell], quantity: str) -> str:
    """Return the values under the cursor, of each cell."""
    texts = [value_text(values, quantity, cells[name].degC) for name, values in shown]
    if len(shown) == 1:
        return texts[0]
    return " · ".join(f"{name} {text}" for (name, _), text in zip(shown, texts, strict=True))


def color_bar(frame: RenderedLook, cells: Mapping[str, ViewedCell]) -> str:
    """Return the colour bar of a rendered look with the values at its ends; none for pictures in colour."""
    look, whole = frame.look, frame.whole
    if whole is None:
        return ""
    ends = [np.array([whole[0] + share * (whole[1] - whole[0])]) for share in look.span]
    texts = [value_text(end, look.quantity, cells[frame.parts[0].cell].degC) for end in ends]
    table = lookup_table(look.colors)[np.linspace(0, 255, STOPS).astype(int)]
    stops = ",".join(f"rgb({r},{g},{b})" for r, g, b in table)
    return (
        f'<div style="{STYLE}"><div style="height:0.8em;border-radius:2px;background:linear-gradient(90deg,{stops})">'
        '</div><div style="display:flex;justify-content:space-between">'
        f"{''.join(f'<span>{escape(text)}</span>' for text in texts)}</div></div>"
    )


def numbers_table(cells: Mapping[str, ViewedCell]) -> str:
    """Return a table of the cells' numbers: scores over the test views, Gaussians, training time."""
    columns = {name: _numbers_of(cell) for name, cell in cells.items()}
    rows = list(dict.fromkeys(row for column in columns.values() for row in column))
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    lines = [[row, *(column.get(row, "") for column in columns.values())] for row in rows]
    body = "".join(f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in line)}</tr>" for line in lines)
    return (
        f'<div style="{STYLE}"><table style="width:100%;text-align:left"><tr><th></th>{head}</tr>{body}</table></div>'
    )


def _numbers_of(cell: ViewedCell) -> dict[str, str]:
    """Return the numbers of a cell by their titles."""
    record, found = cell.record, {}
    for name, measure in METRICS.items():
        if name in record.scores:
            value = record.scores[name]
            found[measure.title] = "n/a" if value is None else f"{value:.{measure.digits}f}"
    found |= {f"Gaussians, {name}": f"{count:,}" for name, count in record.gaussians.items()}
    return found | {
        "iterations": f"{record.iterations:,}",
        "training": str(timedelta(seconds=round(record.seconds["train"]))),
    }

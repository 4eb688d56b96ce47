"""PSNR against training time, as coordinates of an SVG picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from tdgbench.site.packed import Row
from tdgbench.tables import methods
from tdgbench.tables.measures import COLUMNS, HOURS
from tdgbench.text import duration, shortened

WIDTH, HEIGHT = 480, 260
LEFT, RIGHT, TOP, BOTTOM = 40, 130, 12, 42  # margins, px; labels are on the right of points
TICKS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400)  # s
LONGEST = 20  # characters of a label
TICK_WIDTH, LABEL_HEIGHT = 52, 15  # px
PSNR, TIME = COLUMNS.index("psnr"), COLUMNS.index(HOURS.name)


def plot(rows: Sequence[Row]) -> dict[str, Any] | None:
    """Return points and ticks of PSNR against time (logarithmic); None where fewer than two rows have both."""
    known = [row for row in rows if row.scores[PSNR]["sort"] != "" and _seconds(row) > 0]
    if len(known) < 2:
        return None
    seconds, psnr = (np.array(values) for values in ([_seconds(r) for r in known], [_psnr(r) for r in known]))
    low = max((tick for tick in TICKS if tick < seconds.min()), default=seconds.min() / 2)
    high = min((tick for tick in TICKS if tick > seconds.max()), default=seconds.max() * 2)
    ends_x = math.log(low), math.log(high)
    room = max(0.08 * float(np.ptp(psnr)), 0.25)
    ends_y = float(psnr.min()) - room, float(psnr.max()) + room
    step = next(step for step in (0.1, 0.2, 0.5, 1, 2, 5, 10) if (ends_y[1] - ends_y[0]) / step <= 6 or step == 10)
    levels = np.arange(math.ceil(ends_y[0] / step), math.floor(ends_y[1] / step) + 1) * step

    def x(value: float) -> float:
        share = (math.log(value) - ends_x[0]) / (ends_x[1] - ends_x[0])
        return round(LEFT + share * (WIDTH - LEFT - RIGHT), 1)

    def y(value: float) -> float:
        return round(TOP + (ends_y[1] - value) / (ends_y[1] - ends_y[0]) * (HEIGHT - TOP - BOTTOM), 1)

    places = [(x(s), y(p)) for s, p in zip(seconds, psnr, strict=True)]
    labels = _apart([place[1] for place in places])
    ticks: list[tuple[float, str]] = []
    for second in TICKS:
        if low <= second <= high and (not ticks or x(second) - ticks[-1][0] > TICK_WIDTH):
            ticks.append((x(second), duration(second)))
    return {
        "width": WIDTH, "height": HEIGHT, "left": LEFT, "right": WIDTH - RIGHT, "bottom": HEIGHT - BOTTOM, "top": TOP,
        "points": [
            {"x": place[0], "y": place[1], "label_y": label, "name": shortened(methods.label(row.column), LONGEST),
             "title": f"{methods.label(row.column)}, {row.pack.name}: {_psnr(row):.2f} dB in {duration(_seconds(row))}"}
            for row, place, label in zip(known, places, labels, strict=True)
        ],
        "x_ticks": ticks,
        "y_ticks": [(y(level), f"{level:.{1 if step < 1 else 0}f}") for level in levels.tolist()],
    }  # fmt: skip


def _psnr(row: Row) -> float:
    return float(row.scores[PSNR]["sort"])


def _seconds(row: Row) -> float:
    hours = row.scores[TIME]["sort"]
    return 0.0 if hours == "" else 3600 * float(hours)


def _apart(heights: Sequence[float]) -> list[float]:
    """Return heights of labels (px) that do not overlap, near those of their points.

    >>> _apart([20, 21, 100])
    [20, 35, 100]
    """
    found, last = list(heights), -math.inf
    for index in sorted(range(len(heights)), key=lambda index: heights[index]):
        found[index] = last = max(heights[index], last + LABEL_HEIGHT)
    return found

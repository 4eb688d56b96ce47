"""PSNR against training time, as coordinates of an SVG picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from tdgbench.site.packed import BoardRow
from tdgbench.site.ranking import OTHER_IMAGES
from tdgbench.tables import methods
from tdgbench.tables.measures import COLUMNS, HOURS
from tdgbench.text import duration, shortened

WIDTH, HEIGHT = 560, 260
LEFT, RIGHT, TOP, BOTTOM = 40, 210, 12, 42  # margins, px; labels are on the right of points
TICKS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400)  # s
MOST_TICKS = 6  # of PSNR
SHORTEST, LONGEST_TIME, LARGEST = 1e-3, 1e9, 1e300  # s, s, dB; records of others may hold any number: drawn at the ends
LONGEST = 32  # characters of a label
TICK_WIDTH, LABEL_HEIGHT = 52, 15  # px
PSNR, TIME = COLUMNS.index("psnr"), COLUMNS.index(HOURS.name)


class Frame(NamedTuple):
    """The frame of a plot: ends of time (s, on a logarithmic axis) and of PSNR (dB)."""

    first: float
    last: float
    low: float
    high: float

    def x(self, seconds: float) -> float:
        """Return the place of a time, px from the left."""
        share = (math.log(seconds) - math.log(self.first)) / (math.log(self.last) - math.log(self.first))
        return round(LEFT + share * (WIDTH - LEFT - RIGHT), 1)

    def y(self, psnr: float) -> float:
        """Return the place of a PSNR, px from the top."""
        return round(TOP + (self.high - psnr) / (self.high - self.low) * (HEIGHT - TOP - BOTTOM), 1)

    def x_ticks(self) -> list[tuple[float, str]]:
        """Return places and texts of round times that do not overlap."""
        ticks: list[tuple[float, str]] = []
        for second in TICKS:
            if self.first <= second <= self.last and (not ticks or self.x(second) - ticks[-1][0] > TICK_WIDTH):
                ticks.append((self.x(second), duration(second)))
        return ticks

    def y_ticks(self) -> list[tuple[float, str]]:
        """Return places and texts of round PSNRs."""
        step = _step(self.high - self.low)
        levels = np.arange(math.ceil(self.low / step), math.floor(self.high / step) + 1) * step
        return [(self.y(level), _text(level, 1 if step < 1 else 0)) for level in levels.tolist()]


def plots(rows: Sequence[BoardRow]) -> list[dict[str, Any]]:
    """Return a plot for each machine that ran several rows; none of rows of several scenes, or of other images."""
    by_machine: dict[tuple[str, ...], list[BoardRow]] = {}
    for row in rows:
        if len(row.machines) == 1 and not row.twin:
            by_machine.setdefault(next(iter(row.machines)), []).append(row)
    if len({(row.scene, *row.scenes) for row in rows}) > 1 or any(row.unranked == OTHER_IMAGES for row in rows):
        return []
    drawn = [(machine, plot(of_machine)) for machine, of_machine in by_machine.items()]
    where = rows[0].scene if len(rows[0].scenes) == 1 else f"the mean of {', '.join(rows[0].scenes)}"
    return [{**found, "where": where, "machine": machine_in_words(machine)} for machine, found in drawn if found]


def machine_in_words(machine: tuple[str, ...]) -> str:
    """Return the hardware of `Cell.machine`.

    >>> machine_in_words(("Xeon", "None", "2"))
    'Xeon, threads: 2'
    """
    cpu, gpu, threads = machine
    return f"{cpu if gpu == 'None' else gpu}, threads: {threads}"


def plot(rows: Sequence[BoardRow]) -> dict[str, Any] | None:
    """Return points and ticks of PSNR against time (logarithmic); None where fewer than two rows have both."""
    known = [row for row in rows if row.scores[PSNR].sort != "" and _seconds(row) > 0]
    if len(known) < 2:
        return None
    seconds, psnr = [_seconds(row) for row in known], [_psnr(row) for row in known]
    frame = _frame(np.array(seconds), np.array(psnr))
    places = [(frame.x(s), frame.y(p)) for s, p in zip(seconds, psnr, strict=True)]
    points = [
        {"x": place[0], "y": place[1], "label_y": label,
         "name": shortened(f"{methods.label(row.column)}, {row.pack.name}", LONGEST),
         "title": f"{methods.label(row.column)}, {row.pack.name}: {_text(_psnr(row), 2)} dB in "
                  f"{duration(_seconds(row))}"}
        for row, place, label in zip(known, places, _spread([place[1] for place in places]), strict=True)
    ]  # fmt: skip
    return {
        "width": WIDTH, "height": HEIGHT, "left": LEFT, "right": WIDTH - RIGHT, "bottom": HEIGHT - BOTTOM, "top": TOP,
        "points": points, "x_ticks": frame.x_ticks(), "y_ticks": frame.y_ticks(),
    }  # fmt: skip


def _frame(seconds: np.ndarray, psnr: np.ndarray) -> Frame:
    """Return a frame with some room around all points."""
    first = max((tick for tick in TICKS if tick < seconds.min()), default=seconds.min() / 2)
    last = min((tick for tick in TICKS if tick > seconds.max()), default=seconds.max() * 2)
    resolved = 1e-4 * float(np.abs(psnr).max())  # what floats and texts of ticks tell apart
    room = max(0.08 * float(np.ptp(psnr)), 0.25, resolved)
    return Frame(first, last, float(psnr.min()) - room, float(psnr.max()) + room)


def _step(span: float) -> float:
    """Return the smallest of 1, 2 and 5 times powers of ten of which a span has at most MOST_TICKS.

    >>> _step(0.6), _step(0.61), _step(18), _step(2e7)
    (0.1, 0.2, 5.0, 5000000.0)
    """
    power = 10.0 ** math.floor(math.log10(span / MOST_TICKS))
    return next(factor * power for factor in (1, 2, 5, 10, 20) if span / (factor * power) <= MOST_TICKS)


def _text(value: float, digits: int) -> str:
    """Return a number with digits after its point; an impossible one in scientific notation."""
    return f"{value:.{digits}f}" if abs(value) < 1e6 else f"{value:.6g}"


def _psnr(row: BoardRow) -> float:
    return min(max(float(row.scores[PSNR].sort), -LARGEST), LARGEST)


def _seconds(row: BoardRow) -> float:
    hours = row.scores[TIME].sort
    return 0.0 if hours == "" or float(hours) <= 0 else min(max(3600 * float(hours), SHORTEST), LONGEST_TIME)


def _spread(heights: Sequence[float]) -> list[float]:
    """Return heights of labels (px) that do not overlap, near those of their points.

    >>> _spread([20, 21, 100])
    [20, 35, 100]
    """
    found, last = list(heights), -math.inf
    for index in sorted(range(len(heights)), key=lambda index: heights[index]):
        found[index] = last = max(heights[index], last + LABEL_HEIGHT)
    return found

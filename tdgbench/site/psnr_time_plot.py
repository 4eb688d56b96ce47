"""PSNR against training time, as SVG: a plot for each machine."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from tdgbench.present.figures import as_svg, plain
from tdgbench.site.packed import SCORES, BoardRow
from tdgbench.site.ranking import is_disturbed
from tdgbench.tables.likeness import machine_in_words
from tdgbench.tables.measures import HOURS
from tdgbench.text import duration, shortened

TICKS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400)  # s
STEPS = (*TICKS[:4], 15, *TICKS[4:7], 120, 300, 600, 900, *TICKS[11:])  # s, between the ticks of a short axis
MOST_TICKS, MARGIN, LEAST_SPAN = 6, 1.15, 1.0  # MARGIN: of times; LEAST_SPAN: dB, so that ties stand close together
APART = 0.22  # of the axis, at least, so that labels of ticks do not overlap
LIMITS = ((1e-3, 1e9), (-1e6, 1e6))  # s, dB; records of others may hold any number: drawn at the ends
LONGEST = 28  # characters of a label's line
PSNR, TIME = SCORES.index("psnr"), SCORES.index(HOURS.name)


def plots(rows: Sequence[BoardRow]) -> list[tuple[str, str]]:
    """Return SVG and caption for each kind of machine that ran several rows, none of them on a busy one.

    There is none of several scenes, or of unlike rows.
    """
    if len({(row.scene, *row.scenes) for row in rows}) > 1 or any(row.is_unlike for row in rows):
        return []
    by_machine: dict[tuple[str, ...], list[BoardRow]] = {}
    for row in rows:
        if (
            len(row.machines) == 1
            and not row.twin
            and not is_disturbed(row)
            and row.scores[PSNR].sort != ""
            and row.scores[TIME].value > 0
        ):
            by_machine.setdefault(next(iter(row.machines)), []).append(row)
    columns = Counter(row.column for row in rows if not row.twin)
    where = rows[0].scene if len(rows[0].scenes) == 1 else f"the mean of {', '.join(rows[0].scenes)}"
    return [
        (plot([(row.label, row.pack.name if columns[row.column] > 1 else "") for row in group],
              *np.array([[row.scores[TIME].value * 3600, row.scores[TIME].std * 3600, row.scores[PSNR].value,
                          *row.psnr_interval] for row in group]).T),
         f"{where}, on one kind of machine ({machine_in_words(machine)})")
        for machine, group in by_machine.items() if len(group) > 1
    ]  # fmt: skip


def plot(
    names: Sequence[tuple[str, str]],
    seconds: np.ndarray,
    spread: np.ndarray,
    psnr: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> str:
    """Return points of PSNR (dB) against time on a logarithmic axis as SVG, the best one's name on top.

    names: of each point, in two lines. spread: standard deviations of the times, s. low, high: ends of the intervals of
    PSNR. NaN where there is none.
    """
    seconds = np.clip(seconds, *LIMITS[0])
    spread = np.where(spread > 0, spread, 0.0)
    first, last = (np.clip(ends, *LIMITS[0]) for ends in (seconds - spread, seconds + spread))
    psnr, low, high = (np.clip(np.where(np.isfinite(ends), ends, psnr), *LIMITS[1]) for ends in (psnr, low, high))
    lines = 1 + any(second for _, second in names)
    figure = Figure(figsize=(3.3, max(2.7, 0.5 + 0.2 * lines * len(names))))
    axes = figure.subplots()
    axes.set_xscale("log")
    axes.set_xlim(first.min() / MARGIN, last.max() * MARGIN)
    of_psnr, of_time = np.abs([low - psnr, high - psnr]), np.abs([first - seconds, last - seconds])
    axes.errorbar(seconds, psnr, of_psnr, of_time, fmt="o", elinewidth=1, capsize=2)
    middle, span = (low.min() + high.max()) / 2, high.max() - low.min()
    half = max(LEAST_SPAN, 1.2 * span) / 2
    axes.set_ylim(middle - half, middle + half)
    shown = time_ticks(*axes.get_xlim())
    axes.xaxis.set_major_locator(FixedLocator(shown))
    axes.xaxis.set_major_formatter(FixedFormatter([duration(tick) for tick in shown]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(labelsize=9)
    axes.grid(linewidth=0.3)
    for nth, i in enumerate(np.argsort(psnr, kind="stable")):
        axes.annotate(
            "\n".join(plain(shortened(line, LONGEST)) for line in names[i] if line), (seconds[i], psnr[i]),
            (1.06, (nth + 0.5) / len(names)), textcoords="axes fraction", fontsize=9, va="center",
            arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": "gray", "relpos": (0, 0.5)},
        )  # fmt: skip
    with mpl.rc_context({"savefig.bbox": "tight"}):  # labels are whole, however long
        return as_svg(figure)


def time_ticks(low: float, high: float) -> list[int]:
    """Return ticks of a logarithmic axis of seconds: usual times, or on a short axis, multiples of one.

    >>> time_ticks(9, 70), time_ticks(10.5, 17.4)
    ([10, 20, 60], [12, 14, 16])
    """
    found: list[int] = []
    for tick in _all_ticks(low, high):
        if not found or tick >= found[-1] * (high / low) ** APART:
            found.append(tick)
    return found


def _all_ticks(low: float, high: float) -> list[int]:
    usual = [tick for tick in TICKS if low <= tick <= high]
    usual = usual[:: -(-len(usual) // MOST_TICKS) or 1]
    if len(usual) > 2:
        return usual
    multiples = ([*range(-int(-low // step) * step, int(high) + 1, step)] for step in STEPS if step < high)
    return next((found for found in multiples if 2 <= len(found) <= MOST_TICKS), usual or [round(low), round(high)])

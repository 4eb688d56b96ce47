"""PSNR against training time, as SVG: a plot for each machine."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator

from tdgbench.present.figures import as_svg, plain
from tdgbench.site.packed import SCORES, BoardRow
from tdgbench.site.ranking import UNLIKE
from tdgbench.tables import methods
from tdgbench.tables.measures import HOURS
from tdgbench.text import duration, shortened

TICKS = (1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 18000, 36000, 86400)  # s
MOST_TICKS = 6
LIMITS = ((1e-3, 1e9), (-1e6, 1e6))  # s, dB; records of others may hold any number: drawn at the ends
LONGEST = 32  # characters of a label
PSNR, TIME = SCORES.index("psnr"), SCORES.index(HOURS.name)


def plots(rows: Sequence[BoardRow]) -> list[tuple[str, str]]:
    """Return SVG and caption for each machine that ran several rows; none of several scenes, or of unlike rows."""
    if len({(row.scene, *row.scenes) for row in rows}) > 1 or any(row.unranked == UNLIKE for row in rows):
        return []
    by_machine: dict[tuple[str, ...], list[BoardRow]] = {}
    for row in rows:
        if len(row.machines) == 1 and not row.twin and row.scores[PSNR].sort != "" and row.scores[TIME].value > 0:
            by_machine.setdefault(next(iter(row.machines)), []).append(row)
    where = rows[0].scene if len(rows[0].scenes) == 1 else f"the mean of {', '.join(rows[0].scenes)}"
    return [
        (plot([f"{methods.label(row.column)}, {row.pack.name}" for row in group],
              *(np.array([[row.scores[TIME].value * 3600, row.scores[PSNR].value] for row in group]).T)),
         f"{where}, on one machine ({cpu if gpu == 'None' else gpu}, threads: {threads}, cells at once: {at_once})")
        for (cpu, gpu, threads, at_once), group in by_machine.items() if len(group) > 1
    ]  # fmt: skip


def plot(names: Sequence[str], seconds: np.ndarray, psnr: np.ndarray) -> str:
    """Return points of PSNR (dB) against time on a logarithmic axis as SVG, with their names, the best one on top."""
    seconds, psnr = (np.clip(values, *limits) for values, limits in zip((seconds, psnr), LIMITS, strict=True))
    figure = Figure(figsize=(5.2, max(2.7, 0.5 + 0.2 * len(names))))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.11, right=0.58, bottom=0.45 / figure.get_figheight(), top=0.96)
    axes.set_xscale("log")
    axes.margins(y=0.1)
    axes.set_xlim(max((tick for tick in TICKS if tick < seconds.min()), default=seconds.min() / 2),
                  min((tick for tick in TICKS if tick > seconds.max()), default=seconds.max() * 2))  # fmt: skip
    axes.plot(seconds, psnr, "o")
    shown = [tick for tick in TICKS if axes.get_xlim()[0] <= tick <= axes.get_xlim()[1]]
    shown = shown[:: -(-len(shown) // MOST_TICKS) or 1]
    axes.xaxis.set_major_locator(FixedLocator(shown))
    axes.xaxis.set_major_formatter(FixedFormatter([duration(tick) for tick in shown]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(labelsize=9)
    axes.grid(linewidth=0.3)
    for nth, i in enumerate(np.argsort(psnr, kind="stable")):
        axes.annotate(
            plain(shortened(names[i], LONGEST)), (seconds[i], psnr[i]), (1.04, (nth + 0.5) / len(names)),
            textcoords="axes fraction", fontsize=9, va="center",
            arrowprops={"arrowstyle": "-", "linewidth": 0.5, "color": "gray", "relpos": (0, 0.5)},
        )  # fmt: skip
    return as_svg(figure)

"""Quantities that two cells are compared in: scores, times, counts, and numbers from training logs.

Those of logs are the time until a level of PSNR, and the effect of switching the depth loss off.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from tdgbench.cells.renders import budget_of
from tdgbench.scoring import METRICS
from tdgbench.tables.claims.evidence import Claim
from tdgbench.tables.long_table import metric_value
from tdgbench.tables.measures import measure_of
from tdgbench.tables.results import Cell

NumberOf = Callable[[Cell, Claim], float | None]  # None or NaN: n/a
NumbersOf = Callable[[Cell, Cell, Claim], tuple[float, float] | None]


@dataclass(frozen=True)
class Quantity:
    """A number of each of two cells; `numbers` gives both, or None where one lacks it.

    ratio: two cells are compared by their ratio (lower is better), else by their difference. higher: whether higher is
    better. digits: of a difference. timed: it depends on the machine, so only cells of one machine compare.
    counts_gaussians: it is that of initial points until density control begins. kind: quantities of one kind stand for
    one another, where cells have either.
    """

    label: str
    numbers: NumbersOf
    ratio: bool = False
    higher: bool = False
    digits: int = 4
    unit: str = ""
    timed: bool = False
    counts_gaussians: bool = False
    kind: str = ""

    @property
    def sign(self) -> int:
        """1 where higher is better, else −1."""
        return 1 if self.higher else -1

    def gain(self, mine: float, other: float) -> float:
        """Return by how much the first number is better: log(other / mine) of a ratio, else the difference."""
        return float(np.log(other / mine)) if self.ratio else self.sign * (mine - other)

    def least_gain(self, margin: float) -> float:
        """Return the gain that a claim's margin stands for: a share of a ratio (0.1: 10 % less), else a difference."""
        return float(-np.log1p(-margin)) if self.ratio else margin


def _of_each(number: NumberOf) -> NumbersOf:
    def both(mine: Cell, other: Cell, claim: Claim) -> tuple[float, float] | None:
        a, b = number(mine, claim), number(other, claim)
        return None if a is None or b is None or np.isnan(a) or np.isnan(b) else (a, b)

    return both


def _measured(cell: Cell, name: str) -> float:
    return metric_value(cell.record, name)[0]


def _of_measure(name: str) -> NumbersOf:
    return _of_each(lambda cell, _: _measured(cell, name))


def _inconsistency(mine: Cell, other: Cell, _claim: Claim) -> tuple[float, float] | None:
    """Return the geometric mean of the depth inconsistency over the views that have one in both cells.

    Some views overlap with no other one, and some are off by a hundred times the median view. None for scenes with true
    depth, where the error against it is the better measure.
    """
    a, b = mine.views, other.views
    known = any(cell.record.scores.get("depth_abs_rel") is not None for cell in (mine, other))
    if known or a is None or b is None:
        return None
    both = pd.concat([table["depth_inconsistency"] for table in (a, b)], axis=1, join="inner").dropna()
    logs = np.log(both[(both > 0).all(axis=1)])
    return None if logs.empty else (float(np.exp(logs.iloc[:, 0].mean())), float(np.exp(logs.iloc[:, 1].mean())))


def _changes(cell: Cell, _claim: Claim, names: tuple[str, ...]) -> float | None:
    counts = [dict(cell.record.parts.get("thermal", {})).get(name) for name in names]
    return None if None in counts else float(sum(counts))  # type: ignore[arg-type]


def _metric(metric: str) -> Quantity:
    measure = measure_of(metric)
    places, numbers = measure.digits if measure.unit else 4, _of_measure(metric)
    label = measure.label + " of the RGB model" * metric.startswith("rgb_")
    return Quantity(label, numbers, higher=measure.higher_is_better, digits=places, unit=measure.suffix)


def _count(label: str, number: NumberOf) -> Quantity:
    return Quantity(label, _of_each(number), ratio=True, counts_gaussians=True)


def time_to_level(mine: Cell, other: Cell, claim: Claim, column: str) -> tuple[float, float] | None:
    """Return iterations (or seconds) until each run first has one level of training PSNR.

    The level lies `level` (0 to 1) of the way from the start of the runs to the worse run's best. column: `iteration`
    or `seconds`. PSNR is the log's, smoothed over views. None without logs, or if the worse run never improves.
    """
    a, b = mine.log, other.log
    if a is None or b is None:
        return None
    curves = a["smoothed_psnr"], b["smoothed_psnr"]
    start, best = min(curve.iloc[0] for curve in curves), min(curve.max() for curve in curves)
    if best <= start:
        return None
    level = start + claim.level * (best - start)
    return first_at(a, level, column), first_at(b, level, column)


def first_at(log: pd.DataFrame, level: float, column: str, score: str = "smoothed_psnr") -> float:
    """Return the column's value where a score first has the level, linear between lines; ValueError: nowhere.

    >>> log = pd.DataFrame({"smoothed_psnr": [10.0, 20.0], "iteration": [0, 100]})
    >>> first_at(log, 15.0, "iteration")
    50.0
    """
    psnr, along = log[score].to_numpy(float), log[column].to_numpy(float)
    reached = np.flatnonzero(psnr >= level)
    if not len(reached):
        raise ValueError(f"{score} never reaches {level:.2f} dB; it ends at {psnr[-1]:.2f} dB")
    around = slice(max(0, reached[0] - 1), reached[0] + 1)  # the last line below it, and the first that reaches it
    return float(np.interp(level, psnr[around], along[around]))


def psnr_drop(cell: Cell, claim: Claim) -> float | None:
    """Return the fall of training PSNR (dB) at the switch: its mean before, less its lowest value after."""
    windows = _around_switch(cell, claim.window, "smoothed_psnr")
    return None if windows is None else float(windows[0].mean() - windows[1].min())


def loss_rise(cell: Cell, claim: Claim) -> float | None:
    """Return the rise of the thermal loss at the switch: its highest value after, over its mean before."""
    windows = _around_switch(cell, claim.window, "loss_thermal")
    return None if windows is None else float(windows[1].max() / windows[0].mean())


def _around_switch(cell: Cell, window: float, column: str) -> tuple[pd.Series, pd.Series] | None:
    """Return the log's column just before and after the depth loss ends. window: share of iterations on each side.

    None without a log, without an end of the depth loss, or with an empty window.
    """
    log = cell.log
    share = cell.record.setting("method.method.decay_end")
    if log is None or not isinstance(share, int | float) or column not in log:
        return None
    try:
        length = budget_of(cell.record).schedule_length
    except ValueError:
        length = cell.planned_iterations
    switch, width = int(share * length), window * length
    before = log.loc[log["iteration"].between(switch - width, switch, inclusive="left"), column]
    after = log.loc[log["iteration"].between(switch, switch + width), column]
    return (before, after) if len(before) and len(after) else None


QUANTITIES: dict[str, Quantity] = {
    **{metric: _metric(metric) for metric in METRICS},
    "lpips": Quantity("LPIPS", _of_measure("lpips"), ratio=True),
    "dssim": Quantity("1 − SSIM", _of_each(lambda cell, _: 1 - _measured(cell, "ssim")), ratio=True),
    "train_psnr": Quantity("PSNR of training views", _of_measure("train_psnr"), higher=True, digits=2, unit=" dB"),
    "overfit": Quantity(
        "PSNR of training − test views",
        _of_each(lambda cell, _: _measured(cell, "train_psnr") - _measured(cell, "psnr")),
        digits=2,
        unit=" dB",
    ),
    "depth_abs_rel": Quantity("depth error", _of_measure("depth_abs_rel"), ratio=True, kind="depth"),
    "depth_inconsistency": Quantity("depth inconsistency", _inconsistency, ratio=True, kind="depth"),
    "train_hours": Quantity(
        "training time", _of_each(lambda cell, _: cell.record.seconds.get("train")), ratio=True, timed=True
    ),
    "added": _count("clones and splits", partial(_changes, names=("cloned", "split"))),
    "pruned": _count("prunes", partial(_changes, names=("pruned",))),
    "gaussians": _count("Gaussians at the end", lambda cell, _: cell.record.gaussians.get("thermal")),
    "iterations_to_level": Quantity("iterations to the level", partial(time_to_level, column="iteration"), ratio=True),
    "seconds_to_level": Quantity(
        "seconds to the level", partial(time_to_level, column="seconds"), ratio=True, timed=True
    ),
    "psnr_drop": Quantity("drop of training PSNR at the switch", _of_each(psnr_drop), digits=2, unit=" dB"),
    "loss_rise": Quantity("rise of the thermal loss at the switch", _of_each(loss_rise), ratio=True),
}

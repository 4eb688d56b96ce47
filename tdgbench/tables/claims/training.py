"""Numbers from training logs: the time until a level of PSNR, and the effect of switching the depth loss off."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from tdgbench.tables.cell import Cell


def progress(mine: Cell, other: Cell, claim: dict[str, Any], column: str) -> tuple[float, float] | None:
    """Iterations (or seconds) until each run first has one level of training PSNR.

    The level lies `level` (0 to 1) of the way from the start of the runs to the worse run's best. column: `iteration`
    or `seconds`. PSNR is the log's, smoothed over views. None without logs, or if the worse run never improves.
    """
    logs = mine.log(), other.log()
    if logs[0] is None or logs[1] is None:
        return None
    curves = [log["train_psnr"] for log in logs if log is not None]
    start, best = min(curve.iloc[0] for curve in curves), min(curve.max() for curve in curves)
    if best <= start:
        return None
    level = start + claim["level"] * (best - start)
    return first_at(logs[0], level, column), first_at(logs[1], level, column)


def first_at(log: pd.DataFrame, level: float, column: str) -> float:
    """The column's value where train_psnr first has the level, linear between lines. ValueError if it never does.

    >>> log = pd.DataFrame({"train_psnr": [10.0, 20.0], "iteration": [0, 100]})
    >>> first_at(log, 15.0, "iteration")
    50.0
    """
    psnr, along = log["train_psnr"].to_numpy(), log[column].to_numpy(float)
    reached = np.flatnonzero(psnr >= level)
    if not len(reached):
        raise ValueError(f"training PSNR never reaches {level:.2f} dB; it ends at {psnr[-1]:.2f} dB")
    i = int(reached[0])
    if i == 0:
        return float(along[0])
    return float(np.interp(level, psnr[i - 1 : i + 1], along[i - 1 : i + 1]))


def psnr_drop(cell: Cell, claim: dict[str, Any]) -> float | None:
    """Fall of training PSNR (dB) at the switch: its mean before, less its lowest value after."""
    windows = _around_switch(cell, claim["window"], "train_psnr")
    return None if windows is None else float(windows[0].mean() - windows[1].min())


def loss_rise(cell: Cell, claim: dict[str, Any]) -> float | None:
    """Rise of the thermal loss at the switch: its highest value after, over its mean before."""
    windows = _around_switch(cell, claim["window"], "loss_thermal")
    return None if windows is None else float(windows[1].max() / windows[0].mean())


def _around_switch(cell: Cell, window: float, column: str) -> tuple[pd.Series, pd.Series] | None:
    """The log's column just before and just after the end of the depth loss. window: share of iterations on each side.

    None without a log, without an end of the depth loss, or with an empty window.
    """
    log = cell.log()
    share = cell.record.setting("method.method.decay_end")
    if log is None or not isinstance(share, int | float) or column not in log:
        return None
    expected = cell.record.setting("budget.expected_iterations")
    length = min(cell.budget, expected) if isinstance(expected, int) else cell.budget
    switch, width = int(share * length), window * length
    before = log.loc[log["iteration"].between(switch - width, switch, inclusive="left"), column]
    after = log.loc[log["iteration"].between(switch, switch + width), column]
    return (before, after) if len(before) and len(after) else None

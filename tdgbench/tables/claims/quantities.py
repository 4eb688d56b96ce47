"""Quantities that two cells are compared in: scores, times, counts, and numbers from training logs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from tdgbench.scoring import METRICS
from tdgbench.tables.cell import Cell
from tdgbench.tables.claims.training import loss_rise, progress, psnr_drop
from tdgbench.tables.measures import measure

Claim = dict[str, Any]
OneOf = Callable[[Cell, Claim], float | None]
PairOf = Callable[[Cell, Cell, Claim], tuple[float, float] | None]


@dataclass(frozen=True)
class Quantity:
    """A number of each of two cells; `of` gives both, or None where one lacks it.

    ratio: two cells are compared by their ratio (lower is better), else by their difference. higher: whether higher is
    better. digits: of a difference. timed: it depends on the machine, so only cells of one machine compare.
    """

    label: str
    of: PairOf
    ratio: bool = False
    higher: bool = False
    digits: int = 4
    unit: str = ""
    timed: bool = False


def _of_each(number: OneOf) -> PairOf:
    def both(mine: Cell, other: Cell, claim: Claim) -> tuple[float, float] | None:
        a, b = number(mine, claim), number(other, claim)
        return None if a is None or b is None else (a, b)

    return both


def _score(cell: Cell, _claim: Claim, metric: str) -> float | None:
    return cell.record.scores.get(metric)


def _dssim(cell: Cell, _claim: Claim) -> float | None:
    ssim = cell.record.scores.get("ssim")
    return None if ssim is None else 1 - ssim


def _train_psnr(cell: Cell, _claim: Claim) -> float | None:
    return cell.record.train_scores.get("psnr")


def _overfit(cell: Cell, _claim: Claim) -> float | None:
    train, test = cell.record.train_scores.get("psnr"), cell.record.scores.get("psnr")
    return None if train is None or test is None else train - test


def _consistency(mine: Cell, other: Cell, _claim: Claim) -> tuple[float, float] | None:
    """Geometric mean of the depth consistency over the views that have one in both cells.

    Some views overlap with no other one, and some are off by a hundred times the median view. None for scenes with true
    depth, where the error against it is the better measure.
    """
    tables = mine.views(), other.views()
    known = any(cell.record.scores.get("depth_abs_rel") is not None for cell in (mine, other))
    if known or tables[0] is None or tables[1] is None:
        return None
    both = tables[0].merge(tables[1], on="view")[["depth_consistency_x", "depth_consistency_y"]].dropna()
    logs = np.log(both[(both > 0).all(axis=1)])
    return None if logs.empty else (float(np.exp(logs.iloc[:, 0].mean())), float(np.exp(logs.iloc[:, 1].mean())))


def _seconds(cell: Cell, _claim: Claim) -> float | None:
    return cell.record.seconds.get("train")


def _changes(cell: Cell, _claim: Claim, names: tuple[str, ...]) -> float | None:
    done = cell.record.parts.get("thermal")
    return None if done is None else float(sum(done[name] for name in names))  # type: ignore[literal-required]


def _gaussians(cell: Cell, _claim: Claim) -> float | None:
    return cell.record.gaussians.get("thermal")


def _metric(metric: str) -> Quantity:
    described, of = measure(metric), _of_each(partial(_score, metric=metric))
    places = described.digits if described.unit else 4
    return Quantity(metric, of, higher=described.higher_is_better, digits=places, unit=described.suffix)


QUANTITIES: dict[str, Quantity] = {
    **{metric: _metric(metric) for metric in METRICS},
    "lpips": Quantity("lpips", _of_each(partial(_score, metric="lpips")), ratio=True),
    "dssim": Quantity("1 − ssim", _of_each(_dssim), ratio=True),
    "train_psnr": Quantity("PSNR of training views", _of_each(_train_psnr), higher=True, digits=2, unit=" dB"),
    "overfit": Quantity("PSNR of training − test views", _of_each(_overfit), digits=2, unit=" dB"),
    "depth_abs_rel": Quantity("depth error", _of_each(partial(_score, metric="depth_abs_rel")), ratio=True),
    "depth_consistency": Quantity("depth inconsistency", _consistency, ratio=True),
    "hours": Quantity("training time", _of_each(_seconds), ratio=True, timed=True),
    "added": Quantity("clones and splits", _of_each(partial(_changes, names=("cloned", "split"))), ratio=True),
    "pruned": Quantity("prunes", _of_each(partial(_changes, names=("pruned",))), ratio=True),
    "gaussians": Quantity("Gaussians at the end", _of_each(_gaussians), ratio=True),
    "iterations_to_level": Quantity("iterations to the level", partial(progress, column="iteration"), ratio=True),
    "seconds_to_level": Quantity("seconds to the level", partial(progress, column="seconds"), ratio=True, timed=True),
    "psnr_drop": Quantity("drop of training PSNR at the switch", _of_each(psnr_drop), digits=2, unit=" dB"),
    "loss_rise": Quantity("rise of the thermal loss at the switch", _of_each(loss_rise), ratio=True),
}

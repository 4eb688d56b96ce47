"""Two kinds of cells compared pair by pair: the pairs, the interval of a gain, and the verdict on it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, ClaimEvidence, Finding
from tdgbench.tables.results import Cell
from tdgbench.tables.statistics import mean_interval


class Side(NamedTuple):
    """One side of a comparison."""

    method: str
    init: str


class CellPair(NamedTuple):
    """Two cells that differ in method (and its prior) or in init alone."""

    mine: Cell
    other: Cell


class Interval(NamedTuple):
    """A mean and its 95 % interval (NaN for one pair) over a number of pairs in a number of scenes."""

    mean: float
    low: float
    high: float
    pairs: int
    scenes: int


def make_pairs(evidence: ClaimEvidence, mine: Side, other: Side) -> list[CellPair]:
    """Return cells with equal setup, seed and planned iterations: when they settled is an outcome.

    A cell that two experiments hold counts once.
    """
    sides: list[dict[tuple[object, ...], Cell]] = [{}, {}]
    for setup, cell in evidence.placed:
        key = (setup, cell.record.seed, cell.planned_iterations)
        for by_key, side in zip(sides, (mine, other), strict=True):
            if (cell.record.method, cell.record.init) == side:
                by_key.setdefault(key, cell)
    return [CellPair(cell, sides[1][key]) for key, cell in sides[0].items() if key in sides[1]]


def gain_interval(scenes: Sequence[tuple[str, str]], gains: Iterable[float]) -> Interval:
    """Return Student's 95 % interval of the mean gain. scenes: (data set, scene) of each gain.

    Each scene counts once, by the mean of its pairs, so that seeds do not count as scenes. With one scene the interval
    is over its pairs and does not extend to other scenes.

    >>> gain_interval([("a", "x"), ("a", "x"), ("a", "y")], [1.0, 3.0, 4.0]).mean
    3.0
    """
    values = pd.Series(list(gains), index=pd.MultiIndex.from_tuples(list(scenes)), dtype=float)
    by_scene = values.groupby(level=[0, 1]).mean()
    units = (by_scene if len(by_scene) > 1 else values).to_numpy()
    return Interval(*mean_interval(units), len(values), len(by_scene))


def judge_gain(gain: Interval, margin: float) -> str:
    """Return the verdict on a claimed gain. margin: the least gain that the claim's words allow.

    `holds` or `fails` where the whole interval lies above or below the margin, else `undecided`: so with one pair.

    >>> judge_gain(Interval(0.5, low=0.4, high=0.6, pairs=4, scenes=4), margin=0.2)
    'holds'
    """
    return FAILS if gain.high <= margin else HOLDS if gain.low > margin else UNDECIDED


def all_of(findings: Sequence[Finding]) -> Finding:
    """Return one finding of several parts: `holds` where all hold, `fails` where any fails.

    Each part's interval covers 95 % by itself, so a false `fails` becomes likelier with the number of parts.
    """
    verdicts = [found.verdict for found in findings]
    verdict = FAILS if FAILS in verdicts else HOLDS if set(verdicts) == {HOLDS} else UNDECIDED
    parts = [found.grounds if len(findings) == 1 else f"{found.grounds} ({found.verdict})" for found in findings]
    return Finding(verdict, "; ".join(parts))


def counts_in_words(gain: Interval) -> str:
    """Return the number of pairs, and what the interval is over.

    >>> counts_in_words(Interval(0.5, 0.4, 0.6, pairs=12, scenes=4))
    '95 % interval over 4 scenes of 12 pairs'
    """
    if not np.isfinite(gain.low):
        return "one pair has no interval"
    over = f"{gain.scenes} scenes of {gain.pairs} pairs" if gain.scenes > 1 else f"{gain.pairs} pairs of one scene"
    return f"95 % interval over {over}" + ", one seed each" * (gain.pairs == gain.scenes > 1)

"""Two kinds of cells compared pair by pair: the pairs, the interval of a gain, and the verdict on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
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
    """A mean and its 95 % interval (NaN for one unit) over pairs in a number of scenes; of one scene over its seeds."""

    mean: float
    low: float
    high: float
    pairs: int
    scenes: int


def make_pairs(
    evidence: ClaimEvidence, mine: Side, other: Side, stages: Mapping[str, int] | None = None
) -> list[CellPair]:
    """Return cells with equal setup, seed and planned iterations: when they settled is an outcome.

    A cell that two experiments hold counts once. stages: by method, in how many stages its iterations are, one of which
    is compared (`Claim.stages`).
    """
    sides: list[dict[tuple[object, ...], Cell]] = [{}, {}]
    for setup, cell in evidence.placed:
        key = (setup, cell.record.seed, cell.planned_iterations / (stages or {}).get(cell.record.method, 1))
        for by_key, side in zip(sides, (mine, other), strict=True):
            if (cell.record.method, cell.record.init) == side:
                by_key.setdefault(key, cell)
    return [CellPair(cell, sides[1][key]) for key, cell in sides[0].items() if key in sides[1]]


def place_of(cell: Cell) -> tuple[str, str, int]:
    """Return data set, scene and seed of a cell."""
    return (*cell.dataset_and_scene, cell.record.seed)


def gain_interval(places: Sequence[tuple[str, str, int]], gains: Iterable[float]) -> Interval:
    """Return Student's 95 % interval of the mean gain. places: data set, scene and seed of each gain.

    Each scene counts once, by the mean of its pairs, so that seeds do not count as scenes. With one scene the interval
    is over its seeds, each by the mean of its pairs (of two splits, for one), and does not extend to other scenes.

    >>> gain_interval([("a", "x", 0), ("a", "x", 1), ("a", "y", 0)], [1.0, 3.0, 4.0]).mean
    3.0
    """
    values = pd.Series(list(gains), index=pd.MultiIndex.from_tuples(list(places)), dtype=float)
    by_scene, by_seed = values.groupby(level=[0, 1]).mean(), values.groupby(level=2).mean()
    if len(by_scene) > 1:
        return Interval(*mean_interval(by_scene.to_numpy()), len(values), len(by_scene))
    return Interval(*mean_interval(by_seed.to_numpy()), len(by_seed), 1)


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
        return "one seed of one scene has no interval"
    over = f"{gain.scenes} scenes of {gain.pairs} pairs" if gain.scenes > 1 else f"{gain.pairs} seeds of one scene"
    return f"95 % interval over {over}" + ", one seed each" * (gain.pairs == gain.scenes > 1)

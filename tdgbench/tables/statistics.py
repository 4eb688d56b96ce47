"""Uncertainty of our numbers: spread over seeds, intervals over seeds and views."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from zlib import crc32

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from tdgbench.cells.record import Record
from tdgbench.tables.long_table import means, method_label
from tdgbench.tables.measures import AVERAGE, KEYS, OF_RECORDS, OVERALL
from tdgbench.tables.results import Cell

REPLICATES = 1000
SEED = 0
COVERAGE = 0.95
UNEQUAL_SEEDS = "its scenes have unequal seeds, so it has no spread"


def half_width(std: Any, count: Any, tail: float) -> Any:
    """Return half of Student's interval of a mean over `count` values (2 or more) with sample standard deviation.

    tail: probability outside of the interval on each side. Arrays broadcast.

    >>> round(float(half_width(1.0, 4, 0.025)), 3)
    1.591
    """
    return -stdtrit(np.asarray(count) - 1, tail) * std / np.sqrt(count)


def mean_interval(values: np.ndarray) -> tuple[float, float, float]:
    """Return the mean of values (N,) and the ends of its 95 % Student interval; NaN for fewer than two values."""
    mean = float(values.mean())
    half = float(half_width(values.std(ddof=1), len(values), (1 - COVERAGE) / 2)) if len(values) > 1 else float("nan")
    return mean, mean - half, mean + half


def with_interval(text: str, low: float, high: float, form: str) -> str:
    """Return a number, as text, with the ends of its interval, where it has one.

    >>> with_interval("+0.20 dB", -0.32, 0.72, "+.2f")
    '+0.20 dB (-0.32 to +0.72)'
    """
    return text if np.isnan(low) else f"{text} ({low:{form}} to {high:{form}})"


def telling_digits(low: float, high: float, digits: int) -> int:
    """Return digits that tell the ends of an interval apart, at most two more than usual.

    >>> telling_digits(0.0006, 0.0014, 3), telling_digits(-0.3, 0.4, 2), telling_digits(-0.0003, 0.0004, 3)
    (4, 2, 4)
    """
    return next((d for d in range(digits, digits + 3) if round(low, d) != round(high, d)), digits)


def seed_values(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the values of `cell_rows` by seed: a column for each seed, a row for each KEYS, averages included.

    NaN where a method lacks the seed; an average has the seeds that all of its scenes have.
    """
    by_seed = cells.groupby([*KEYS, "seed"], sort=False)["value"].mean().unstack("seed")
    by_seed = by_seed.reindex(pd.MultiIndex.from_frame(cells[KEYS].drop_duplicates()))
    return _with_averages(by_seed, by_seed).set_index(KEYS)[list(by_seed)]


def with_seeds(rows: pd.DataFrame, cells: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the rows with seeds (their number) and std (sample standard deviation; NaN below two); values by seed.

    rows: have KEYS. cells: `cell_rows`. The values are `seed_values` with the rows' index. An average over scenes with
    unequal seeds has none: it is no mean over the seeds that all of them have, whose spread would not be its own.
    """
    by_seed = seed_values(cells).reindex(pd.MultiIndex.from_frame(rows[KEYS])).set_index(rows.index)
    of_scenes = cells.dropna(subset=["value", "seed"])
    seeds, std, reason = by_seed.count(axis=1), by_seed.std(axis=1), rows["reason"]
    for names, scene in ((["method", "dataset", "metric"], AVERAGE), (["method", "metric"], OVERALL)):
        most = of_scenes.groupby(names)["seed"].nunique()  # of all scenes together
        unequal = (rows["scene"] == scene) & (seeds < pd.MultiIndex.from_frame(rows[names]).map(most.to_dict()))
        seeds, std = seeds.mask(unequal, 0), std.mask(unequal)
        reason = reason.mask(unequal & rows["value"].notna() & (reason == ""), UNEQUAL_SEEDS)
    return rows.assign(seeds=seeds, std=std, reason=reason), by_seed


def intervals(cells: Iterable[Cell]) -> pd.DataFrame:
    """Return KEYS, ci95_low, ci95_high of each mean, by a bootstrap over seeds and test views.

    The views are the same in all seeds, so more seeds tell no more of other views. An average has an interval if all of
    its scenes have one.
    """
    numbers = pd.DataFrame(
        [
            [*_place(cell.record), metric, cell.folder, values]
            for cell in sorted(cells, key=lambda cell: (cell.record.title, cell.record.seed))
            for metric, values in _values(cell).items()
        ],
        columns=[*KEYS, "cell", "values"],
    )
    if numbers.empty:
        return pd.DataFrame(columns=[*KEYS, "ci95_low", "ci95_high"]).astype({"ci95_low": float, "ci95_high": float})
    seeds = numbers.groupby(KEYS[:4], sort=False)["cell"].transform("nunique")
    of_all_seeds = numbers[numbers.groupby(KEYS, sort=False)["cell"].transform("count") == seeds]
    means = {key: _replicates(list(group), key) for key, group in of_all_seeds.groupby(KEYS, sort=False)["values"]}
    places = numbers[KEYS[:4]].drop_duplicates().merge(numbers[["method", "metric"]].drop_duplicates(), on="method")
    drawn = pd.DataFrame(list(means.values()), pd.MultiIndex.from_tuples(means, names=KEYS))
    drawn = drawn.reindex(pd.MultiIndex.from_frame(places[KEYS]))  # an average over a missing number is none
    datasets = of_all_seeds.groupby("method")["dataset"].nunique()
    several = drawn[drawn.index.get_level_values("method").isin(datasets.index[datasets > 1])]
    rows = _with_averages(drawn, several)
    low, high = np.quantile(rows[drawn.columns].to_numpy(), [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2], axis=1)
    return rows[KEYS].assign(ci95_low=low, ci95_high=high)


def _place(record: Record) -> list[str]:
    """Return a cell's values of KEYS but the metric."""
    return [method_label(record, with_init=True), record.dataset, record.group, record.scene]


def _values(cell: Cell) -> dict[str, np.ndarray]:
    """Return every number of a cell: those of its record as one value, and scores of each view, by view."""
    numbers = {one.name: np.array([one.of_record(cell.record)]) for one in OF_RECORDS if one.in_main_table}
    views = cell.views  # None: `read_results` reports it
    if views is not None and len(views):
        numbers |= {str(metric): values.to_numpy() for metric, values in views.dropna(axis=1).items()}
    return numbers


def _replicates(seeds: list[np.ndarray], key: Iterable[str]) -> np.ndarray:
    """Draw REPLICATES means: seeds are drawn with replacement, and so are views, the same ones in all of them.

    seeds: numbers of each one's views. key: of KEYS; equal numbers at equal places give equal draws.
    """
    rng = np.random.default_rng([SEED, crc32("\0".join(key).encode())])
    places = rng.random((REPLICATES, max(map(len, seeds))))
    chosen = rng.integers(len(seeds), size=(REPLICATES, len(seeds)))
    by_seed = [values[(places[:, : len(values)] * len(values)).astype(np.intp)].mean(axis=1) for values in seeds]
    return np.stack(by_seed, axis=1)[np.arange(REPLICATES)[:, None], chosen].mean(axis=1)


def _with_averages(rows: pd.DataFrame, several: pd.DataFrame) -> pd.DataFrame:
    """Return rows with the index KEYS, now columns, and their averages. several: those of an overall average."""
    parts = [rows.reset_index()]
    if not rows.empty:
        of_each = means(rows, ["method", "dataset", "metric"], rows.columns).reset_index()
        parts.append(of_each.assign(group="", scene=AVERAGE))
    if not several.empty:
        overall = means(several, ["method", "metric"], rows.columns).reset_index()
        parts.append(overall.assign(dataset="", group="", scene=OVERALL))
    return pd.concat(parts, ignore_index=True)

"""Uncertainty of our numbers: spread over seeds, intervals over seeds and views, tests of a method against another."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import stdtrit

from tdgbench.cells.folder import CellFolder
from tdgbench.cells.paths import cell_folder_of
from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Record
from tdgbench.tables.long_table import method_label, scene_rows, with_averages
from tdgbench.tables.measures import AVERAGE, HOURS, KEYS, OF_RECORDS, OVERALL, TRAINING, gain
from tdgbench.tables.methods import MethodPair
from tdgbench.tables.palette import COLUMN, values_over_scenes
from tdgbench.tables.published import published_main

REPLICATES = 1000
SEED = 0
COVERAGE = 0.95


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


def over_seeds(records: list[Record], plan: Plan, init: str | None = None) -> pd.DataFrame:
    """Return KEYS, seeds, std: the sample standard deviation over seeds, averages included (NaN below two)."""
    seeds = sorted({record.seed for record in records if record.failure is None})
    parts = [with_averages(scene_rows([r for r in records if r.seed == seed], plan, init)) for seed in seeds]
    if not parts:
        return pd.DataFrame(columns=[*KEYS, "seeds", "std"])
    grouped = pd.concat(parts, ignore_index=True).groupby(KEYS, sort=False)["value"]
    return grouped.agg(seeds="count", std="std").reset_index()


def intervals(records: list[Record], experiment: Path) -> pd.DataFrame:
    """Return KEYS, ci95_low, ci95_high of each mean, by a bootstrap over seeds and the test views of each seed."""
    rng = np.random.default_rng(SEED)
    cells: dict[tuple[str, str, str, str], list[dict[str, np.ndarray]]] = {}
    for record in sorted(records, key=lambda r: (r.title, r.seed)):
        if record.failure is None:
            key = (method_label(record, with_init=True), record.dataset, record.group, record.scene)
            cells.setdefault(key, []).append(_values(record, experiment))
    replicates: dict[tuple[str, ...], np.ndarray] = {}
    for key, seeds in cells.items():
        for metric in seeds[0]:
            if all(metric in values for values in seeds):
                replicates[(*key, metric)] = _replicates([values[metric] for values in seeds], rng)
    rows = [_row(key, drawn) for key, drawn in replicates.items()]
    for method in dict.fromkeys(key[0] for key in replicates):
        datasets = list(dict.fromkeys(key[1] for key in replicates if key[0] == method))
        for dataset in [*datasets, *([""] if len(datasets) > 1 else [])]:
            for metric in dict.fromkeys(key[4] for key in replicates if key[0] == method):
                chosen = [k for k in replicates if k[0] == method and k[4] == metric and dataset in ("", k[1])]
                group = [replicates[k] for k in chosen]
                scene = AVERAGE if dataset else OVERALL
                rows.append(_row((method, dataset, "", scene, metric), np.mean(group, axis=0)))
    return pd.DataFrame(rows, columns=[*KEYS, "ci95_low", "ci95_high"])


def _values(record: Record, experiment: Path) -> dict[str, np.ndarray]:
    """Return every number of a cell: scores by view, hours as one value."""
    values_by_name = {
        described.name: np.array([described.of_record(record)]) for described in OF_RECORDS if described.in_main_table
    }
    try:
        rows = list(CellFolder(cell_folder_of(experiment, record), record).read_views().values())
    except (FileNotFoundError, ValueError):  # `read_results` reports it
        rows = []
    for metric in rows[0] if rows else []:
        values = [row[metric] for row in rows]
        if None not in values:
            values_by_name[metric] = np.array(values)
    return values_by_name


def _replicates(seeds: list[np.ndarray], rng: np.random.Generator) -> np.ndarray:
    """Draw REPLICATES means: seeds are drawn with replacement, and so are each one's views."""
    shape = (REPLICATES, len(seeds))
    means = np.array([values[rng.integers(len(values), size=(*shape, len(values)))].mean(axis=2) for values in seeds])
    chosen = rng.integers(len(seeds), size=shape)
    return np.take_along_axis(means, chosen[None], axis=0)[0].mean(axis=1)


def _row(key: tuple[str, ...], drawn: np.ndarray) -> dict[str, object]:
    low, high = np.quantile(drawn, [(1 - COVERAGE) / 2, (1 + COVERAGE) / 2])
    return {**dict(zip(KEYS, key, strict=True)), "ci95_low": float(low), "ci95_high": float(high)}


class MethodComparison(NamedTuple):
    """A method against its baseline. paired: from `paired_tests`. speed: from `speed_table`."""

    pair: MethodPair
    paired: pd.DataFrame
    speed: pd.DataFrame


def speed_ratios(main: pd.DataFrame, pair: MethodPair) -> pd.DataFrame:
    """Return dataset, group, scene, ratio: hours over the baseline's, which compare between machines."""
    hours = main[main["metric"] == HOURS.name]
    wide = hours.pivot_table(index=["dataset", "group", "scene"], columns="method", values="value", sort=False)
    if not set(pair) <= set(wide):
        return pd.DataFrame(columns=["dataset", "group", "scene", "ratio"])
    return (wide[pair.method] / wide[pair.baseline]).rename("ratio").reset_index()


def speed_table(main: pd.DataFrame, pair: MethodPair) -> pd.DataFrame:
    """Return dataset, group, scene, ours, published: hours of the method over those of its baseline."""
    ours = speed_ratios(main, pair).rename(columns={"ratio": "ours"})
    published = speed_ratios(published_main(), pair).rename(columns={"ratio": "published"})
    return ours.merge(published, on=["dataset", "group", "scene"], how="left")


def paired_tests(main: pd.DataFrame, pair: MethodPair) -> pd.DataFrame:
    """Return metric, scenes, better, p, image_values of tests over scenes that a method is better.

    p: of Wilcoxon's one-sided signed-rank test.
    """
    single = main[~main["scene"].isin((AVERAGE, OVERALL))]
    rows = []
    for metric, group in single[~single["metric"].isin(TRAINING)].groupby("metric", sort=False):
        wide = group.pivot_table(index=["dataset", "scene"], columns="method", values="value", sort=False)
        if not set(pair) <= set(wide):
            continue
        both = wide[list(pair)].dropna()
        gains = gain(str(metric), both[pair.method], both[pair.baseline])
        p = float("nan")
        if len(gains) >= 5 and (gains != 0).any():  # with fewer, no outcome could be below 5 %
            from scipy.stats import wilcoxon  # takes half a second to import, and most runs do without

            p = float(wilcoxon(gains, alternative="greater").pvalue)
        better, compared = int((gains > 0).sum()), group[group["method"].isin(pair) & group["value"].notna()]
        rows.append([metric, len(gains), better, p, values_over_scenes(compared)])
    return pd.DataFrame(rows, columns=["metric", "scenes", "better", "p", COLUMN])

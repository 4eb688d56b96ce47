"""Cells that two experiments share, and the differences of their scores: B − A, with intervals over the common seeds.

Where nothing but the run differs, the two cells of a pair are repeats of one training: their spread (of a GPU, whose
sums have no fixed order) is not the spread over seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.present.grid import Grid, GridCell, GridRow
from tdgbench.tables import methods
from tdgbench.tables.long_table import metric_value
from tdgbench.tables.measures import COLUMNS as OF_TABLES
from tdgbench.tables.measures import GAUSSIANS, MEASURES, as_text
from tdgbench.tables.palette import COLUMN, MARK, image_values, palette_notes
from tdgbench.tables.results import Cell
from tdgbench.tables.verdicts import REPRODUCED, UNDECIDED, judge_score, load_margins, seeds_interval

FIRST = (*OF_TABLES, GAUSSIANS.name)  # numbers that are shown first
IDENTICAL, EQUIVALENT = "identical", "equivalent"
PLACE = ["dataset", "scene", "method", "init", "variant"]
COLUMNS = [
    *PLACE, "metric", "seeds", "of_seeds", "a", "b", "difference", "ci90_low", "ci90_high", "margin", "verdict",
    "repeat_std", "seed_std", COLUMN,
]  # fmt: skip

Place = tuple[str, ...]  # values of PLACE
place_of: Callable[[Record], Place] = attrgetter(*PLACE)


class ComparedCell(NamedTuple):
    a: Cell
    b: Cell


class Difference(NamedTuple):
    """B − A of a metric on average, with Student's 90 % interval over the seeds; NaN where it is not known."""

    mean: float = nan
    low: float = nan
    high: float = nan


@dataclass(frozen=True)
class Pairs:
    """Pairs by place and seed, and the records of finished cells that only one experiment has."""

    by_place: dict[Place, dict[int, ComparedCell]]
    only_a: list[Record]
    only_b: list[Record]

    def __iter__(self) -> Iterator[ComparedCell]:
        return (pair for seeds in self.by_place.values() for pair in seeds.values())

    def __len__(self) -> int:
        return sum(len(seeds) for seeds in self.by_place.values())


def find_pairs(a: Iterable[Cell], b: Iterable[Cell]) -> Pairs:
    """Match the finished cells of two experiments."""
    mine, theirs = ({(place_of(cell.record), cell.record.seed): cell for cell in cells} for cells in (a, b))
    by_place: dict[Place, dict[int, ComparedCell]] = {}
    for place, seed in sorted(mine.keys() & theirs.keys()):
        by_place.setdefault(place, {})[seed] = ComparedCell(mine[place, seed], theirs[place, seed])
    alone = ([cells[key].record for key in sorted(cells.keys() - others.keys())]
             for cells, others in ((mine, theirs), (theirs, mine)))  # fmt: skip
    return Pairs(by_place, *alone)


def score_table(pairs: Pairs, are_repeats: bool) -> pd.DataFrame:
    """Return COLUMNS: a row per place and number that both cells of all its pairs have.

    are_repeats: what is trained and scored is the same in both, so that equal seeds show the spread of a repeat.

    seeds, of_seeds: how many and which both have. a, b, difference: means over them. ci90: of the difference, by
    Student; NaN for one seed. verdict: `identical` if every pair has equal numbers; else of the interval against the
    metric's margin, as for published numbers: `equivalent`, `better` or `worse` (B than A), `undecided`; empty without
    a margin. repeat_std: of one training run again, from the differences of equal seeds; NaN where they are no repeats.
    seed_std: over the seeds, mean of both. image_values: whether the images of either are in a palette.
    """
    rows = []
    for place, by_seed in pairs.by_place.items():
        values_of_images, seeds = image_values(cell.record for pair in by_seed.values() for cell in pair), [*by_seed]
        for metric in MEASURES:
            values = np.array([_values(pair, metric) for pair in by_seed.values()])
            if not np.isnan(values).any():
                counted = [len(seeds), " ".join(map(str, seeds))]
                rows.append([*place, metric, *counted, *_compared(metric, values, are_repeats), values_of_images])
    return pd.DataFrame(rows, columns=COLUMNS)


def _values(pair: ComparedCell, metric: str) -> list[float]:
    return [metric_value(cell.record, metric)[0] for cell in pair]


def _difference(differences: np.ndarray) -> Difference:
    """Return the mean of differences (seeds,) with its interval."""
    seeds, mean = len(differences), float(differences.mean())
    if seeds < 2:
        return Difference(mean)
    return Difference(mean, *map(float, seeds_interval(mean, float(differences.std(ddof=1)), seeds)))


def _compared(metric: str, values: np.ndarray, are_repeats: bool) -> list[object]:
    """Return the columns from `a` to `seed_std`. values: (seeds, 2), of A and B."""
    differences, margin = values[:, 1] - values[:, 0], load_margins().get(metric, nan)
    found = _difference(differences)
    verdict = _verdict(metric, differences, found, margin)
    repeat = float(np.sqrt((differences**2).mean() / 2)) if are_repeats else nan
    over_seeds = float(values.std(axis=0, ddof=1).mean()) if len(values) > 1 else nan
    return [*values.mean(axis=0).tolist(), *found, margin, verdict, repeat, over_seeds]


def _verdict(metric: str, differences: np.ndarray, found: Difference, margin: float) -> str:
    if not differences.any():
        return IDENTICAL
    if np.isnan(margin):
        return ""
    if np.isnan(found.low):
        return UNDECIDED
    verdict = str(judge_score(found.low, found.high, 0.0, 0.0, margin, MEASURES[metric].higher_is_better))
    return EQUIVALENT if verdict == REPRODUCED else verdict


NUMBERS = {"a": "A", "b": "B", "difference": "B − A", "interval": "90 % interval", "repeat_std": "std of a repeat",
           "seed_std": "std over seeds"}  # headings  # fmt: skip


def comparison_grid(table: pd.DataFrame) -> Grid:
    """Return the score table as readers see it, without what all rows share. `place` of a row: PLACE and metric."""
    heads = [name for name in PLACE if name in ("scene", "method") or table[name].nunique() > 1]
    numbers = [name for name in NUMBERS if name not in table or table[name].notna().any()]
    rows = []
    for row in table.to_dict("records"):
        measure, place = MEASURES[row["metric"]], tuple(row[name] for name in PLACE)
        name = measure.label + (f", {measure.images}" if measure.images else "")
        scene = f"{row['scene']} {MARK}" if row[COLUMN] else row["scene"]
        shown = {**row, "method": methods.label(row["method"]), "scene": scene}
        verdict = GridCell("", sort=row["verdict"], note=row["verdict"], verdict=row["verdict"])
        cells = (GridCell(row["of_seeds"], sort=row["seeds"]), *_number_cells(row, numbers), verdict)
        names = (*(shown[head] for head in heads), name)
        rows.append(GridRow(names, cells, (*place, row["metric"]), is_marked=bool(row[COLUMN])))
    notes = palette_notes(table.drop(columns="method"))
    return Grid([*heads, "score"], ["seeds", *(NUMBERS[name] for name in numbers), "verdict"], rows, notes)


def _number_cells(row: Mapping[str, Any], numbers: Sequence[str]) -> list[GridCell]:
    """Return NUMBERS of a row of the score table."""
    metric, signed = row["metric"], ("difference", "ci90_low", "ci90_high")
    texts = {name: as_text(metric, row[name]) for name in ("a", "b")}
    texts |= {name: difference_as_text(metric, row[name]) for name in signed}
    texts |= {name: difference_as_text(metric, row[name], "") for name in ("repeat_std", "seed_std")}
    texts["interval"] = "n/a" if texts["ci90_low"] == "n/a" else f"{texts['ci90_low']} to {texts['ci90_high']}"
    values = {**row, "interval": row["ci90_low"]}
    return [GridCell(texts[name], sort="" if np.isnan(values[name]) else values[name]) for name in numbers]


def difference_as_text(metric: str, value: float, sign: str = "+") -> str:
    """Return a difference or a spread with three digits, and a count as one; n/a for NaN.

    >>> difference_as_text("psnr", -6.0), difference_as_text("gaussians", 263.7, ""), difference_as_text("ssim", 1e-6)
    ('-6.00', '264', '+1.00e-06')
    """
    is_count = not MEASURES[metric].digits or abs(value) >= 100
    return "n/a" if np.isnan(value) else as_text(metric, value, form=f"{sign}.0f" if is_count else f"{sign}#.3g")


def verdicts(table: pd.DataFrame, pairs: Pairs) -> list[str]:
    """Return a sentence on each metric with a margin: verdicts of the score table of pairs, and B − A on average over
    the places, by the seeds that all places have, with its interval if there is one.
    """
    sentences = []
    for metric, group in table[table["margin"].notna()].groupby("metric", sort=False):
        words = ", ".join(f"{number} {word}" for word, number in group["verdict"].value_counts().items())
        text, measure = f"{MEASURES[str(metric)].label}: {words}", MEASURES[str(metric)]
        if (group["verdict"] != IDENTICAL).any():
            by_place = [pairs.by_place[place] for place in group[PLACE].itertuples(index=False, name=None)]
            common = sorted(set.intersection(*map(set, by_place)))
            values = np.array([[_values(by_seed[seed], measure.name) for seed in common] for by_seed in by_place])
            found = _difference(np.diff(values).mean(axis=(0, 2))) if common else Difference(group["difference"].mean())
            mean, low, high = (difference_as_text(measure.name, value) for value in found)
            text += f"; B − A {mean}{measure.suffix}{f' on average of {len(group)}' if len(group) > 1 else ''}"
            if low == "n/a":
                text += ", by one seed, which shows no difference"
            else:
                zero = ", which contains zero" if found.low <= 0 <= found.high else ""
                text += f", 90 % interval {low} to {high}{zero}"
        sentences.append(text)
    return sentences

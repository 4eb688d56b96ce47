"""Cells that two experiments share, and the differences of their scores.

A cell of A and one of B form a pair if they have the same method, data set, scene, initial points, variant and seed.
Differences are B − A, and their intervals are over the seeds that both have. Where nothing but the run differs, the two
cells of a pair are repeats of one training: their spread (of a GPU, whose sums have no fixed order) is not the
spread over seeds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tdgbench.present.grid import Grid, GridCell, GridRow
from tdgbench.tables.long_table import metric_value
from tdgbench.tables.measures import MEASURES, as_text
from tdgbench.tables.palette import COLUMN, MARK, image_values, palette_notes
from tdgbench.tables.results import Cell
from tdgbench.tables.verdicts import REPRODUCED, UNDECIDED, judge_score, load_margins, seeds_interval

IDENTICAL, EQUIVALENT = "identical", "equivalent"
PLACE = ["dataset", "scene", "method", "init", "variant"]
COLUMNS = [
    *PLACE, "metric", "seeds", "a", "b", "difference", "ci90_low", "ci90_high", "margin", "verdict", "repeat_std",
    "seed_std", COLUMN,
]  # fmt: skip

Place = tuple[str, ...]  # values of PLACE


class ComparedCell(NamedTuple):
    """The same cell of two experiments."""

    a: Cell
    b: Cell


@dataclass(frozen=True)
class Pairs:
    """Pairs by place and seed, and the titles of finished cells that only one experiment has."""

    by_place: dict[Place, dict[int, ComparedCell]]
    only_a: list[str]
    only_b: list[str]

    def __iter__(self) -> Iterator[ComparedCell]:
        return (pair for seeds in self.by_place.values() for pair in seeds.values())

    def __len__(self) -> int:
        return sum(len(seeds) for seeds in self.by_place.values())


def find_pairs(a: Iterable[Cell], b: Iterable[Cell]) -> Pairs:
    """Match the finished cells of two experiments."""
    identity = attrgetter(*PLACE)
    mine, theirs = ({(identity(cell.record), cell.record.seed): cell for cell in cells} for cells in (a, b))
    by_place: dict[Place, dict[int, ComparedCell]] = {}
    for place, seed in sorted(mine.keys() & theirs.keys()):
        by_place.setdefault(place, {})[seed] = ComparedCell(mine[place, seed], theirs[place, seed])
    alone = ([cells[key].record.title for key in sorted(cells.keys() - others.keys())]
             for cells, others in ((mine, theirs), (theirs, mine)))  # fmt: skip
    return Pairs(by_place, *alone)


def score_table(pairs: Pairs, are_repeats: bool) -> pd.DataFrame:
    """Return COLUMNS: a row per place and number that both cells of all its pairs have.

    are_repeats: what is trained and scored is the same in both, so that equal seeds show the spread of a repeat.

    a, b, difference: means over the seeds. ci90: of the difference, by Student; NaN for one seed. verdict: `identical`
    if every pair has equal numbers; else of the interval against the metric's margin, as for published numbers:
    `equivalent`, `better` or `worse` (B than A), `undecided`; empty without a margin. repeat_std: of one training run
    again, from the differences of equal seeds; NaN where they are no repeats. seed_std: over the seeds, mean of both.
    image_values: whether the images of either are in a palette.
    """
    rows = []
    for place, by_seed in pairs.by_place.items():
        values_of_images = image_values(cell.record for pair in by_seed.values() for cell in pair)
        for metric in MEASURES:
            values = np.array(
                [[metric_value(cell.record, metric)[0] for cell in pair] for pair in by_seed.values()], dtype=float
            )
            if not np.isnan(values).any():
                rows.append([*place, metric, *_compared(metric, values, are_repeats), values_of_images])
    return pd.DataFrame(rows, columns=COLUMNS)


def _compared(metric: str, values: np.ndarray, are_repeats: bool) -> list[object]:
    """Return the columns from `seeds` to `seed_std`. values: (seeds, 2), of A and B."""
    seeds, differences = len(values), values[:, 1] - values[:, 0]
    mean, margin = float(differences.mean()), load_margins().get(metric, np.nan)
    std = float(differences.std(ddof=1)) if seeds > 1 else np.nan
    low, high = map(float, seeds_interval(mean, std, seeds)) if seeds > 1 else (np.nan, np.nan)
    verdict = _verdict(metric, differences, (low, high), margin)
    repeat = float(np.sqrt((differences**2).mean() / 2)) if are_repeats else np.nan
    over_seeds = float(values.std(axis=0, ddof=1).mean()) if seeds > 1 else np.nan
    return [seeds, *values.mean(axis=0).tolist(), mean, low, high, margin, verdict, repeat, over_seeds]


def _verdict(metric: str, differences: np.ndarray, interval: tuple[float, float], margin: float) -> str:
    if not differences.any():
        return IDENTICAL
    if np.isnan(margin):
        return ""
    if np.isnan(interval[0]):
        return UNDECIDED
    verdict = str(judge_score(*interval, 0.0, 0.0, margin, MEASURES[metric].higher_is_better))
    return EQUIVALENT if verdict == REPRODUCED else verdict


NUMBERS = {"a": "A", "b": "B", "difference": "B − A", "interval": "90 % interval", "repeat_std": "std of a repeat",
           "seed_std": "std over seeds"}  # headings  # fmt: skip


def comparison_grid(table: pd.DataFrame) -> Grid:
    """Return the score table as readers see it. `place` of a row: PLACE and metric."""
    rows = []
    for row in table.to_dict("records"):
        measure, place = MEASURES[row["metric"]], tuple(row[name] for name in PLACE)
        name = measure.label + (f", {measure.images}" if measure.images else "")
        scene = f"{row['scene']} {MARK}" if row[COLUMN] else row["scene"]
        cells = (
            GridCell(str(row["seeds"]), sort=row["seeds"]),
            *_number_cells(row),
            GridCell("", sort=row["verdict"], note=row["verdict"], verdict=row["verdict"]),
        )
        heads = (place[0], scene, *place[2:], name)
        rows.append(GridRow(heads, cells, (*place, row["metric"]), is_marked=bool(row[COLUMN])))
    notes = palette_notes(table.drop(columns="method"))
    return Grid([*PLACE, "score"], ["seeds", *NUMBERS.values(), "verdict"], rows, notes)


def _number_cells(row: Mapping[str, Any]) -> list[GridCell]:
    """Return NUMBERS of a row of the score table."""
    metric, signed = row["metric"], {"difference", "ci90_low", "ci90_high"}
    forms = {"a": "", "b": "", **dict.fromkeys(signed, "+.3g"), "repeat_std": ".2g", "seed_std": ".2g"}
    texts = {k: "n/a" if np.isnan(row[k]) else as_text(metric, row[k], form=form) for k, form in forms.items()}
    texts["interval"] = "n/a" if texts["ci90_low"] == "n/a" else f"{texts['ci90_low']} to {texts['ci90_high']}"
    values = {**row, "interval": row["ci90_low"]}
    return [GridCell(texts[name], sort="" if np.isnan(values[name]) else values[name]) for name in NUMBERS]


def verdicts_by_metric(table: pd.DataFrame) -> pd.DataFrame:
    """Return metric, places, mean and largest difference, and counts of verdicts, of metrics with a margin."""
    rows = []
    for metric, group in table[table["margin"].notna()].groupby("metric", sort=False):
        counts = group["verdict"].value_counts()
        largest = group["difference"].iloc[group["difference"].abs().argmax()]
        words = ", ".join(f"{number} {word}" for word, number in counts.items())
        rows.append([metric, len(group), group["difference"].mean(), largest, words])
    return pd.DataFrame(rows, columns=["metric", "places", "mean", "largest", "verdicts"])

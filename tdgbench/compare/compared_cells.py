"""Differences of the scores of pairs: B − A, with intervals over the common seeds and verdicts.

Where nothing but the run differs, the two cells of a pair are repeats of one training: their spread (of a GPU, whose
sums have no fixed order) is not the spread over seeds.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from math import nan
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tdgbench.compare.causes import DATA, MACHINE, VERSION, Cause, why_no_times
from tdgbench.compare.pairs import PLACE, ComparedCell, Pairs, Place
from tdgbench.present.grid import Grid, GridCell, GridRow
from tdgbench.scoring.metric import Measure
from tdgbench.tables import methods
from tdgbench.tables.comparisons import margins_in_words
from tdgbench.tables.equal_data import changed_scores
from tdgbench.tables.grids import GAUSSIANS_NOTE
from tdgbench.tables.likeness import was_disturbed
from tdgbench.tables.long_table import metric_value
from tdgbench.tables.measures import COLUMNS as OF_TABLES
from tdgbench.tables.measures import GAUSSIANS, HOURS, MEMORY, RecordMeasure, as_text, known_measures, measure_of
from tdgbench.tables.palette import IMAGES, MARK, image_values, palette_notes
from tdgbench.tables.verdicts import REPRODUCED, UNDECIDED, judge_score, load_margins, seeds_interval
from tdgbench.text import first_few, one_line

FIRST = (*OF_TABLES, GAUSSIANS.name)  # numbers that are shown first
IDENTICAL, EQUIVALENT, NOT_COMPARED = "identical", "equivalent", "not compared"
TWO_PROTOCOLS, OTHER_DATA = "two protocols", "other data of the scene"  # begin the reason
ONE_TRAINING = "nothing was trained twice"
CHANGED = "a record was changed: of equal renders and ground truth"  # and protocol
SMALLEST = 1e-4  # spread that is printed
USUAL = {"init": "colmap", "variant": ""}  # which readers assume
COLUMNS = [
    *PLACE, "metric", "seeds", "of_seeds", "a", "b", "difference", "ci90_low", "ci90_high", "margin", "verdict",
    "reason", "repeat_std", "seed_std", IMAGES,
]  # fmt: skip


class Difference(NamedTuple):
    """B − A of a metric on average, with Student's 90 % interval over the seeds; NaN where it is not known."""

    mean: float = nan
    low: float = nan
    high: float = nan


def score_table(pairs: Pairs, causes: Sequence[Cause]) -> pd.DataFrame:
    """Return COLUMNS: a row per place and number that either cell of its pairs has, and per score with a margin.

    seeds, of_seeds: how many and which both have. a, b, difference: means over them. ci90: of the difference, by
    Student; NaN for one seed. verdict: `identical` if every pair has equal numbers; else of the interval against the
    metric's margin, as for published numbers: `equivalent`, `better` or `worse` (B than A), `undecided`; empty without
    a margin; `not compared`, for `reason`, where a cell lacks the number, its meaning differs, or both cells are one
    training and it is no score. repeat_std: of one training run again, from the differences of equal seeds; NaN where
    they are no repeats: more than the machine differs, or nothing was trained twice. seed_std: over the seeds, mean of
    both. image_values: whether the images of either are in a palette.
    """
    rows = []
    for place, by_seed in pairs.by_place.items():
        values_of_images, seeds = image_values(cell.record for pair in by_seed.values() for cell in pair), [*by_seed]
        is_repeat = not any(pair.is_one_training for pair in by_seed.values())
        is_elsewhere = any(place in cause.places for cause in causes)  # times and memory depend on the machine
        is_repeat &= all(cause.kind in (MACHINE, VERSION) or place not in cause.places for cause in causes)
        of_pairs = [changed_scores(cell.record for cell in pair) for pair in by_seed.values()]
        changed = {name for of_content in of_pairs for names in of_content.values() for name in names}
        for metric in known_measures():
            values = np.array([_values(pair, metric) for pair in by_seed.values()])
            if np.isnan(values).all() and metric not in load_margins():
                continue
            reason = _why_not_compared(metric, place, by_seed, causes, changed)
            is_same = is_repeat and not (isinstance(measure_of(metric), RecordMeasure) and is_elsewhere)
            compared = _compared(metric, values, is_same, reason)
            counted = [len(seeds), " ".join(map(str, seeds))]
            rows.append([*place, metric, *counted, *compared, values_of_images])
    return pd.DataFrame(rows, columns=COLUMNS)


def _why_not_compared(
    metric: str, place: Place, by_seed: Mapping[int, ComparedCell], causes: Iterable[Cause], changed: Collection[str]
) -> str:
    """Return why a number of A and B is not compared; empty if it is. changed: from `changed_scores`, of all pairs."""
    lacking: dict[str, dict[int, str]] = {}
    for seed, pair in by_seed.items():
        for name, cell in zip("AB", pair, strict=True):
            value, why = metric_value(cell.record, metric)
            if np.isnan(value):
                lacking.setdefault(name, {})[seed] = why
    if lacking:
        seeds = {seed: why for of_cell in lacking.values() for seed, why in of_cell.items()}
        some = "" if len(seeds) == len(by_seed) else f" of seed {first_few(map(str, seeds))}"
        why = next((one_line(why) for why in seeds.values() if why), "not recorded")
        return f"{'A and B have' if len(lacking) > 1 else f'{min(lacking)} has'} none{some}: {why}"
    if isinstance(measure_of(metric), RecordMeasure):
        if any(pair.is_one_training for pair in by_seed.values()):
            return ONE_TRAINING
        if metric == MEMORY.name:
            return "its process may have compiled, scored or trained more"
        if metric != HOURS.name:
            return ""
        is_busy = any(was_disturbed(cell.record) for pair in by_seed.values() for cell in pair)
        return "times of a busy machine" if is_busy else why_no_times(c for c in causes if place in c.places)
    unlike = [cause for cause in causes if place in cause.places and metric in cause.scores]
    if unlike:
        changes = "; ".join(cause.name if cause.varies else cause.change for cause in unlike)
        return f"{OTHER_DATA if any(cause.name == DATA for cause in unlike) else TWO_PROTOCOLS} ({changes})"
    return CHANGED if metric in changed else ""


def _values(pair: ComparedCell, metric: str) -> list[float]:
    return [metric_value(cell.record, metric)[0] for cell in pair]


def _difference(differences: np.ndarray) -> Difference:
    """Return the mean of differences (seeds,) with its interval."""
    seeds, mean = len(differences), float(differences.mean())
    if seeds < 2:
        return Difference(mean)
    return Difference(mean, *map(float, seeds_interval(mean, float(differences.std(ddof=1)), seeds)))


def _compared(metric: str, values: np.ndarray, is_repeat: bool, reason: str) -> list[object]:
    """Return the columns from `a` to `seed_std`. values: (seeds, 2), of A and B. reason: why they are not compared."""
    differences, margin = values[:, 1] - values[:, 0], load_margins().get(metric, nan)
    means = values.mean(axis=0).tolist()
    if reason:
        return [*means, *Difference(), margin, NOT_COMPARED, reason, nan, nan]
    found = _difference(differences)
    verdict = _verdict(metric, differences, found, margin)
    repeat = float(np.sqrt((differences**2).mean() / 2)) if is_repeat else nan
    over_seeds = float(values.std(axis=0, ddof=1).mean()) if len(values) > 1 else nan
    return [*means, *found, margin, verdict, "", repeat, over_seeds]


def _verdict(metric: str, differences: np.ndarray, found: Difference, margin: float) -> str:
    if not differences.any():
        return IDENTICAL
    if np.isnan(margin):
        return ""
    if np.isnan(found.low):
        return UNDECIDED
    verdict = str(judge_score(found.low, found.high, 0.0, 0.0, margin, measure_of(metric).higher_is_better))
    return EQUIVALENT if verdict == REPRODUCED else verdict


NUMBERS = {"a": "A", "b": "B", "difference": "B − A", "interval": "90 % interval", "repeat_std": "std of a repeat",
           "seed_std": "std over seeds"}  # headings  # fmt: skip


def legend(table: pd.DataFrame) -> list[str]:
    """Return what verdicts and spreads of a score table mean, for those that it has."""
    lines, is_judged = [], table["margin"].notna() & table["ci90_low"].notna() & (table["verdict"] != IDENTICAL)
    if is_judged.any():
        lines.append(
            f"{EQUIVALENT}: the 90 % interval of B − A, over seeds, lies within the margin ({margins_in_words()}); "
            f"better, worse: outside of it; {UNDECIDED}: anything else. 90 %: equivalence is two one-sided tests of 5 %"
        )
    spreads = {"repeat_std": "std of a repeat: of a cell trained again with the same seed",
               "seed_std": "std over seeds: mean of A's and B's"}  # fmt: skip
    shown = "; ".join(text for name, text in spreads.items() if table[name].notna().any())
    return [*lines, *filter(None, [shown]), *([GAUSSIANS_NOTE] if GAUSSIANS.name in set(table["metric"]) else [])]


def place_heads(table: pd.DataFrame) -> list[str]:
    """Return the columns of PLACE that readers need: scene, method, what rows differ in, and what is not usual."""
    unusual = {name for name, value in USUAL.items() if (table[name] != value).any()}
    return [name for name in PLACE if name in ("scene", "method") or name in unusual or table[name].nunique() > 1]


def place_in_words(place: Place, heads: Sequence[str]) -> str:
    """Return a place by the columns that readers need (`place_heads`).

    >>> place_in_words(("synthetic", "night", "tdg", "random", ""), ["scene", "method", "init"])
    'TDg on night, random'
    """
    known = dict(zip(PLACE, place, strict=True))
    more = [known[name] for name in heads if name not in ("scene", "method") and known[name]]
    return ", ".join([f"{methods.label(known['method'])} on {known['scene']}", *more])


def comparison_grid(table: pd.DataFrame, said: Iterable[str] = ()) -> Grid:
    """Return the score table as readers see it, without what all rows share. `place` of a row: PLACE and metric.

    said: sentences beside it, whose reasons for what is not compared are not repeated below.
    """
    heads = place_heads(table)
    numbers = [name for name in NUMBERS if table["ci90_low" if name == "interval" else name].notna().any()]
    rows = []
    for row in table.to_dict("records"):
        measure, place = measure_of(row["metric"]), tuple(row[name] for name in PLACE)
        name = ", ".join(filter(None, (measure.label, measure.unit, measure.images)))
        scene = f"{row['scene']} {MARK}" if row[IMAGES] else row["scene"]
        shown = {**row, "method": methods.label(row["method"]), "scene": scene}
        verdict = GridCell("", sort=row["verdict"], note=row["verdict"], verdict=row["verdict"])
        seeds = GridCell("seed " * (row["seeds"] == 1) + row["of_seeds"].replace(" ", ", "), sort=row["seeds"])
        names = (*(shown[head] for head in heads), name)
        cells = (seeds, *_number_cells(row, numbers), verdict)
        rows.append(GridRow(names, cells, (*place, row["metric"]), is_marked=bool(row[IMAGES])))
    notes = palette_notes(table.drop(columns="method"))
    for reason, of_reason in table[table["verdict"] == NOT_COMPARED].groupby("reason", sort=False):
        if not any(str(reason) in sentence for sentence in said):
            labels = dict.fromkeys(measure_of(metric).label for metric in of_reason["metric"])
            notes.append(f"{NOT_COMPARED}: {', '.join(labels)}: {reason}")
    return Grid([*heads, "score"], ["seeds", *(NUMBERS[name] for name in numbers), "verdict"], rows, notes)


def _number_cells(row: Mapping[str, Any], numbers: Sequence[str]) -> list[GridCell]:
    """Return NUMBERS of a row of the score table."""
    metric = row["metric"]
    texts = {name: "n/a" if np.isnan(row[name]) else as_text(metric, row[name]) for name in ("a", "b")}
    texts["difference"] = difference_as_text(metric, row["difference"])
    texts["interval"] = interval_as_text(metric, row["ci90_low"], row["ci90_high"])
    texts |= {name: spread_as_text(metric, row[name]) for name in ("repeat_std", "seed_std")}
    values = {**row, "interval": row["ci90_low"]}
    return [GridCell(texts[name], sort="" if np.isnan(values[name]) else values[name]) for name in numbers]


def difference_as_text(metric: str, value: float) -> str:
    """Return a difference with three digits, and a count as one; n/a for NaN.

    Below a unit of the last digit with which the metric is printed, it is that unit.

    >>> [difference_as_text("psnr", value) for value in (-6.0, -6e-6, 0.0)], difference_as_text("gaussians", 263.7)
    (['-6.00', 'within ±0.01', '0'], '+264')
    """
    digits = measure_of(metric).digits
    if np.isnan(value) or value == 0:
        return "n/a" if np.isnan(value) else "0"
    if metric != HOURS.name and abs(value) < 10.0**-digits:
        return f"within ±{10.0**-digits:.{digits}f}"
    return as_text(metric, value, form="+.0f" if not digits or abs(value) >= 100 else "+#.3g")


def interval_as_text(metric: str, low: float, high: float) -> str:
    """Return an interval as text; where one end alone is below a unit, with its sign and a digit more.

    >>> interval_as_text("psnr", -0.001, 0.002), interval_as_text("psnr", -0.001, 2.0)
    ('within ±0.01', '-0.001 to +2.00')
    """
    ends = [difference_as_text(metric, end) for end in (low, high)]
    if ends[0] == ends[1]:
        return ends[0]
    form = f"+.{measure_of(metric).digits + 1}f"
    return " to ".join(f"{end:{form}}" if "±" in text else text for text, end in zip(ends, (low, high), strict=True))


def spread_as_text(metric: str, value: float) -> str:
    """Return a standard deviation with three digits, and of a count as one; n/a for NaN.

    >>> spread_as_text("psnr", 0.0723), spread_as_text("ssim", 1e-6)
    ('0.0723', '< 0.0001')
    """
    if metric != HOURS.name and 0 < value < SMALLEST:
        return f"< {SMALLEST}"
    is_count = not measure_of(metric).digits or value >= 100
    return "n/a" if np.isnan(value) else as_text(metric, value, form=".0f" if is_count else "#.3g")


def verdicts(table: pd.DataFrame, pairs: Pairs) -> list[str]:
    """Return a sentence on each metric with a margin: verdicts of the score table of pairs, and B − A on average over
    the places, by the seeds that all places have, with its interval if there is one.
    """
    judged = table[table["margin"].notna()]
    reasons = judged["reason"].unique()
    if len(reasons) == 1 and reasons[0]:
        return [f"no score is compared: {reasons[0]}"]
    places = f"({', '.join(place_heads(table))})"
    return [
        _verdicts_of(measure_of(str(metric)), group, pairs, places)
        for metric, group in judged.groupby("metric", sort=False)
    ]


def _verdicts_of(measure: Measure, group: pd.DataFrame, pairs: Pairs, places: str) -> str:
    """Return the sentence on a metric. group: its rows. places: what rows are of, in words."""
    counts, several = group["verdict"].value_counts(), len(group) > 1
    words = ", ".join(f"{word} on {number}" if several else str(word) for word, number in counts.items())
    text = f"{measure.label}, B against A: {words}{f' of {len(group)} {places}' if several else ''}"
    reasons, compared = "; ".join(filter(None, group["reason"].unique())), group[group["verdict"] != NOT_COMPARED]
    if compared.empty:
        return f"{measure.label}: {NOT_COMPARED}, {reasons}"
    if not (compared["verdict"] == IDENTICAL).all():
        by_place = [pairs.by_place[place] for place in compared[PLACE].itertuples(index=False, name=None)]
        common = sorted(set.intersection(*map(set, by_place)))
        values = np.array([[_values(by_seed[seed], measure.name) for seed in common] for by_seed in by_place])
        found = _difference(np.diff(values).mean(axis=(0, 2))) if common else Difference(compared["difference"].mean())
        text += f"; B − A {difference_as_text(measure.name, found.mean)}{measure.suffix}"
        marked = image_values(cell.record for by_seed in by_place for pair in by_seed.values() for cell in pair)
        text += f" on average{f' ({marked})' * bool(marked)}" if len(compared) > 1 else ""
        text += ", the identical ones too" if (compared["verdict"] == IDENTICAL).any() else ""
        if any(set(by_seed) != set(common) for by_seed in by_place):
            text += f", over seed{'s' * (len(common) > 1)} {', '.join(map(str, common))}, which all have" * bool(common)
        if np.isnan(found.low):
            text += ", by one seed: it decides nothing" if common else ", of unlike seeds: it decides nothing"
        else:
            zero = ", which contains zero" if found.low <= 0 <= found.high else ""
            text += f", 90 % interval over seeds {interval_as_text(measure.name, found.low, found.high)}{zero}"
    return f"{text}; {NOT_COMPARED}: {reasons}" if reasons else text

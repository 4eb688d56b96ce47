"""The spread between papers on the same method and scene, and whether a gain is larger than that spread.

Papers differ in splits, training lengths, seeds and code. A gain inside one paper must exceed their spread before it
can be told from the choice of setup. Averages are compared over the scenes that the papers share, never as printed:
papers average over different scenes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial

import numpy as np
import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.tables.long_table import with_averages
from tdgbench.tables.measures import AVERAGE, HOURS, KEYS, OVERALL, digits, gain, measure_of
from tdgbench.tables.methods import label, paper_pair
from tdgbench.tables.palette import with_text_of_cells
from tdgbench.tables.published import PAPER, load_sources, published_elsewhere, published_main
from tdgbench.tables.published_setup import departures

PLACE = ["method", "dataset", "scene", "metric"]
SHARED = "Average (shared scenes)"
FOLLOWS, OFF, UNKNOWN = "follows", "does not follow", "cannot be recomputed"


@cache
def between_papers() -> pd.DataFrame:
    """Return one row per method, dataset, scene and metric that two papers or more print.

    Columns: PLACE, papers (their number), low, high, spread (high − low), scenes (1, or those of the average), values
    (in words), note (where a source does not settle its method). The scene SHARED is the average over the scenes that
    all papers on the method have.
    """
    numbers = _numbers()
    rows = [_row(place, group) for place, group in numbers.groupby(PLACE, sort=False) if group["source"].nunique() > 1]
    for (method, dataset, metric), group in numbers.groupby(["method", "dataset", "metric"], sort=False):
        wide = group.pivot(index="scene", columns="source", values="value").dropna()
        if wide.shape[1] > 1 and len(wide) > 1:
            means = wide.mean().rename("value").reset_index()
            means["printed_as"] = means["source"].map(group.groupby("source")["printed_as"].first())
            rows.append(_row((method, dataset, SHARED, metric), means, len(wide)))
    return pd.DataFrame(rows)


def with_other_papers(differences: pd.DataFrame) -> pd.DataFrame:
    """Return the table with others_low, others_high (NaN without another paper's number), why they may be of another
    method (others_doubt), and the number of papers."""
    if "scene" not in differences:  # the ablation: averages, which other papers take over other scenes
        return differences.assign(others_low=np.nan, others_high=np.nan, others_doubt="", papers=1)
    others = _numbers().query("source != @PAPER").groupby(PLACE)
    ranges = others["value"].agg(others_low="min", others_high="max", papers="count")
    ranges["others_doubt"] = others["doubt"].agg(lambda doubts: "; ".join(filter(None, dict.fromkeys(doubts))))
    merged = differences.merge(ranges.reset_index(), on=PLACE, how="left").fillna({"others_doubt": ""})
    merged["papers"] = merged["papers"].fillna(0).astype(int) + 1
    return merged


def against_others(main: pd.DataFrame, records: Sequence[Record], column: Callable[[Record], str]) -> pd.DataFrame:
    """Return other papers' numbers of our methods beside ours: source, PLACE, printed_as, selected_on, published, ours,
    std, seeds, image_values (of ours), difference (ours − published), unlike.

    unlike: in what our cells are not of the published setup, or why the number may be of another method; where there is
    anything, the difference is n/a. records: behind the main table; column: of a record's method. Averages are left
    out: papers average over different scenes.
    """
    others = published_elsewhere().rename(columns={"value": "published"}).drop(columns="group")
    sources = load_sources()
    others["selected_on"] = [sources[name]["selected_on"] for name in others["source"]]
    ours = main[[*PLACE, "value", "std", "seeds", "image_values"]].rename(columns={"value": "ours"})
    merged = others[others["scene"] != AVERAGE].merge(ours, on=PLACE)
    setups = {metric: partial(departures, metric=metric) for metric in dict.fromkeys(merged["metric"])}
    told = with_text_of_cells(merged, records, setups, column)
    unlike = [
        "; ".join(filter(None, (doubt, told.at[row, metric])))
        for row, metric, doubt in zip(merged.index, merged["metric"], _doubts(merged), strict=True)
    ]
    difference = (merged["ours"] - merged["published"]).where([not text for text in unlike])
    return merged.assign(difference=difference, unlike=unlike)


def gain_against_spread(main: pd.DataFrame, metrics: list[str]) -> str:
    """Return the paper's average gain over its baseline against the spread between papers on the baseline, in words.

    main: a main table. Empty where the table has no gain, or lacks the scenes that papers share, over which both are
    compared.
    """
    spreads = between_papers()
    sentences, notes = list[str](), list[str]()
    for metric in metrics:
        group = spreads[(spreads["method"] == paper_pair().baseline) & (spreads["metric"] == metric)]
        gains, places = _gains(main, metric), group.loc[group["scene"] != SHARED, "scene"]
        # of hours, for one, there is no spread: only one paper prints them
        if group.empty or not set(places) <= set(gains.index) or not gains.get(OVERALL, np.nan) > 0:
            continue
        shared = group[group["scene"] == SHARED].iloc[0]
        mean = gains.reindex(places).mean()
        numbers = (gains[OVERALL], mean, shared.spread)
        total, there, spread = (f"{value:.{digits(metric, OVERALL)}f}{measure_of(metric).suffix}" for value in numbers)
        larger = "larger than" if mean > shared.spread else "smaller than"
        compared = "equal to" if np.isclose(mean, shared.spread) else larger
        sentences.append(
            f"the gain in {measure_of(metric).label} is {total}; over the {shared.scenes} scenes that papers share it "
            f"is {there}, {compared} the {spread} by which {shared.papers} papers' averages of "
            f"{label(paper_pair().baseline)} differ"
        )
        notes += [shared.note] * bool(shared.note)
    unsure = (f"not sure to be {label(paper_pair().baseline)}: {note}" for note in dict.fromkeys(notes))
    return "; ".join((*sentences, *unsure))


def check_averages(table: pd.DataFrame) -> pd.DataFrame:
    """Return one row per average: KEYS, printed, mean (of its rows), tolerance, verdict.

    table: KEYS, value and half_unit (half a unit of the last printed digit; 0 for numbers that were not rounded).
    tolerance: the largest difference between the printed average and the mean of the printed rows due to rounding.
    """
    is_average = table["scene"].isin((AVERAGE, OVERALL))
    scenes = table[~is_average].assign(reason="")
    parts = []
    for name, column in (("mean", "value"), ("of_rows", "half_unit")):
        made = with_averages(scenes.assign(value=scenes[column]))
        parts.append(made.rename(columns={"value": name})[[*KEYS, name]])
    averages = table[is_average].rename(columns={"value": "printed"})
    for part in parts:
        averages = averages.merge(part, on=KEYS, how="left")
    averages["tolerance"] = averages["half_unit"] + averages["of_rows"]
    off = (averages["mean"] - averages["printed"]).abs() > averages["tolerance"] + 1e-12
    averages["verdict"] = off.map({True: OFF, False: FOLLOWS})
    averages.loc[averages["mean"].isna() | averages["printed"].isna(), "verdict"] = UNKNOWN
    return averages[[*KEYS, "printed", "mean", "tolerance", "verdict"]]


def _numbers() -> pd.DataFrame:
    """Return source, PLACE, value, printed_as of all papers: scores of single scenes."""
    paper = published_main().assign(source=PAPER)
    table = pd.concat([paper.assign(printed_as=paper["method"]), published_elsewhere()], ignore_index=True)
    chosen = table[~table["scene"].isin((AVERAGE, OVERALL)) & (table["metric"] != HOURS.name)]
    return chosen.assign(doubt=_doubts(chosen))[["source", *PLACE, "value", "printed_as", "doubt"]]


def _doubts(numbers: pd.DataFrame) -> list[str]:
    """Return for each number of a source why it may not be of our method; empty where the source settles it."""
    sources = load_sources()
    entries = (
        (name, printed, sources[name]["methods"].get(printed, {}))
        for name, printed in zip(numbers["source"], numbers["printed_as"], strict=True)
    )
    return [
        f"{name}, {printed}: {entry['note']}" if entry and not entry["sure"] else "" for name, printed, entry in entries
    ]


def _row(place: tuple[str, ...], group: pd.DataFrame, scenes: int = 1) -> dict[str, object]:
    places, notes = digits(place[3]), filter(None, _doubts(group))
    low, high = float(group["value"].min()), float(group["value"].max())
    values = "; ".join(f"{row.source} {row.value:.{places}f}" for row in group.itertuples())
    return {
        **dict(zip(PLACE, place, strict=True)),
        "papers": len(group), "low": low, "high": high, "spread": round(high - low, 9), "scenes": scenes,
        "values": values, "note": "; ".join(notes),
    }  # fmt: skip


def _gains(main: pd.DataFrame, metric: str) -> pd.Series:
    """Return the gain of the paper's method over its baseline, by scene; scenes without both are dropped."""
    pair = paper_pair()
    chosen = main[(main["metric"] == metric) & main["method"].isin(pair)]
    wide = chosen.pivot_table(index="scene", columns="method", values="value", aggfunc="first")
    if not set(pair) <= set(wide):
        return pd.Series(dtype=float)
    return gain(metric, wide[pair.method], wide[pair.baseline]).dropna()

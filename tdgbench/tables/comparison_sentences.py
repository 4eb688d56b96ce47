"""Sentences that compare a method with its baseline: on how many scenes it is better, by how much, on what grounds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from typing import Any

import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.tables import methods
from tdgbench.tables.comparisons import COUNTED, EQUAL, MethodComparison, margin_of, may_be_within_margin
from tdgbench.tables.grids import ERROR
from tdgbench.tables.likeness import TRAINING_KIND, is_selected, times_at_once
from tdgbench.tables.long_table import NO_RECORD, method_label
from tdgbench.tables.measures import AVERAGE, HOURS, MAIN_COLUMNS, MAIN_SCORES, OVERALL, as_text, digits, measure_of
from tdgbench.tables.published import published_main
from tdgbench.tables.readings import widest_average
from tdgbench.tables.seed_spreads import usual_spread
from tdgbench.tables.statistics import telling_digits, with_interval
from tdgbench.tables.verdicts import UNDECIDED

TOLD = (*MAIN_COLUMNS, ERROR)  # measures


def sentences_of(comparison: MethodComparison, main: pd.DataFrame, records: Sequence[Record]) -> Iterable[str]:
    """Compare a method with its baseline: on how many scenes it is better, and by how much on the widest average."""
    pair, changes, paired = comparison
    title = " against ".join(title_of(column, records) for column in pair)
    both = main[main["method"].isin(pair) & main["metric"].isin(TOLD)]
    rows = changes[changes["metric"].isin(TOLD) & changes["scene"].isin(both["scene"])].dropna(subset="change")
    scenes = rows[~is_average(rows)]
    if scenes.empty:
        kinds = both.loc[both["metric"] == MAIN_COLUMNS[0], TRAINING_KIND].unique()
        unlike = f"trainings differ ({' / '.join(filter(None, kinds))})"
        of_scores = changes[(changes["metric"] == MAIN_COLUMNS[0]) & ~is_average(changes)]
        lacking, *more = [*filter(None, of_scores["reason"].unique()), ""]
        why = unlike if len(kinds) > 1 else "no scene has results of both" if len(more) != 1 else lacking
        yield f"{title}: not compared: {why_not(both, why)}"
        return
    compared = scenes[["dataset", "scene"]].drop_duplicates()
    several = len(compared) > 1
    without = len(both.loc[~is_average(both), ["dataset", "scene"]].drop_duplicates()) - len(compared)
    notes = [f"n/a on {without} more"] if without else []
    timed = both.loc[(both["metric"] == HOURS.name) & both["value"].notna(), "method"].nunique() == len(pair)
    is_timed = HOURS.name in set(scenes["metric"])
    times = times_of(pair, records) if is_timed else [_why_no_times(changes)] * timed
    if several and scenes["seeds"].max() > 1:
        has_p = paired.loc[paired["metric"].isin(TOLD), "p"].notna().any()
        tests = ["p: Wilcoxon's signed-rank test over scenes, one-sided: the method is better"] if has_p else []
        yield "; ".join([f"{title} on {len(compared)} scenes: {_counts(paired, scenes)}", *tests, *times, *notes])
        notes = []
    place = widest_average(rows) if several else scenes
    if several and not is_average(place).all():  # some scene lacks results, so there is no average
        return
    where = f"on average over {len(compared)} scenes" if several else f"on {compared['scene'].iloc[0]}"
    of_scenes = main.merge(place[["dataset", "scene"]].drop_duplicates() if not several else compared)
    grounds = [
        *_range(scenes) * several,
        *_lengths(pair, records, set(compared.itertuples(index=False, name=None))),
        *_certainty(place, of_scenes),
        *times,
        *_published_time(pair, scenes),
        *notes,
    ]
    yield f"{title} {where}: {'; '.join([*map(_change, place.itertuples()), *grounds])}"


def _lengths(pair: methods.MethodPair, records: Sequence[Record], compared: Collection[tuple[str, str]]) -> list[str]:
    """Return after how many iterations the trainings of a pair ended, in a list; empty where all have the same.

    compared: data sets and scenes that count.
    """
    sides: list[dict[tuple[object, ...], int]] = [
        {
            (one.dataset, one.scene, one.seed): one.iterations
            for one in records
            if method_label(one, with_init=True) == column
            and one.made_elsewhere is None
            and (one.dataset, one.scene) in compared
        }
        for column in pair
    ]
    both = sides[0].keys() & sides[1].keys()
    found = [{side[place] for place in both} for side in sides]
    if not both or len(set().union(*found)) == 1:
        return []
    ends = [" to ".join(dict.fromkeys((str(min(each)), str(max(each))))) for each in found]
    return [f"trainings ended after {' against '.join(ends)} iterations"]


def _why_no_times(changes: pd.DataFrame) -> str:
    rows = changes[(changes["metric"] == HOURS.name) & ~is_average(changes)]
    return f"times are not compared: {' or '.join(dict.fromkeys(rows['reason']))}"


def _range(scenes: pd.DataFrame) -> list[str]:
    """Return how far the changes of single scenes in the first score are apart. scenes: changes."""
    metric = MAIN_SCORES[0]
    changes, measure = scenes.loc[scenes["metric"] == metric, "change"], measure_of(metric)
    ends = [f"{change:+.{digits(metric)}f}" for change in (changes.min(), changes.max())]
    return [f"{measure.label} of single scenes {' to '.join(ends)}{measure.suffix}"] if len(changes) else []


def title_of(column: str, records: Sequence[Record]) -> str:
    """Return a method's name, with what else its scores come from: more than thermal images, or a choice by them."""
    cells = [one for one in records if method_label(one, with_init=True) == column]
    sources = " or ".join(filter(None, dict.fromkeys(cell.prior_source.in_full for cell in cells)))
    selected = " (checkpoint chosen by test views: its scores are too high)" * any(map(is_selected, cells))
    prior = f" with a depth prior made from {sources}" if sources else ""
    doubted = " (doubted: see the doubts)" * any(one.has_doubts_of_its_own for one in cells)
    return methods.label(column) + prior + selected + doubted


def times_of(columns: Iterable[str], records: Sequence[Record]) -> list[str]:
    """Return the note on times of some columns, in a list; empty if each cell ran alone."""
    columns = list(columns)
    return times_at_once(record for record in records if method_label(record, with_init=True) in columns)


def _counts(paired: pd.DataFrame, scenes: pd.DataFrame) -> str:
    """Return on how many scenes a method is better, worse, equal, undecided, by metric, with p. scenes: changes."""
    parts = []
    for row in paired[paired["metric"].isin(TOLD)].itertuples():
        found = Counter(map(_verdict_word, scenes[scenes["metric"] == row.metric].itertuples()))
        words = [f"{word} on {found[word]}" for word in sorted(found, key=lambda one: COUNTED.index(one.split(",")[0]))]
        parts += [f"{measure_of(row.metric).label} {', '.join(words)}{_p(row.p)}"] if words else []
    return "; ".join(parts)


def _verdict_word(row: Any) -> str:
    """Return a change's verdict; of one that may lie within the margin, that its size is open."""
    return f"{row.verdict}, by how much is open," if may_be_within_margin(row) else str(row.verdict)


def _change(row: Any) -> str:
    """Return both values, the change and, where it has an interval, its verdict. row: of a comparison's changes."""
    measure, values = measure_of(row.metric), (as_text(row.metric, value, row.scene) for value in (row.new, row.old))
    places = telling_digits(row.ci95_low, row.ci95_high, 2 if measure.ratio else digits(row.metric, row.scene))
    form = f".{places}f" if measure.ratio else f"+.{places}f"
    change = f"× {row.change:{form}}" if measure.ratio else f"{row.change:{form}}{measure.suffix}"
    text = f"{measure.label} {' against '.join(values)}, "
    if not _has_interval(row):
        return text + change + f": {UNDECIDED} (two seeds)" * (row.seeds == 2)
    verdict, margin, stated = row.verdict, margin_of(row.metric), f"{margin_of(row.metric):g}{measure.suffix}"
    if verdict == EQUAL:
        verdict += f" within {stated}" * (margin > 0)
    elif may_be_within_margin(row):
        verdict = f"{'higher' if row.change > 0 else 'lower'}, whether by more than {stated} is undecided"
    return f"{text}{with_interval(change, row.ci95_low, row.ci95_high, form)}: {verdict}"


def _has_interval(row: Any) -> bool:
    """Return whether an interval says something: one of two seeds that decides nothing may be of any width."""
    return row.seeds > 2 or (row.seeds == 2 and row.verdict != UNDECIDED)


def _certainty(place: pd.DataFrame, main: pd.DataFrame) -> list[str]:
    """Return over how many seeds changes have intervals, in a list; of one seed, how far seeds are usually apart.

    place: changes at one place. main: rows of the scenes, of all methods.
    """
    seeds = place["seeds"].max()
    if seeds < 2:
        alone = " that both have" if main["seeds"].max() > 1 else ""
        return [f"one seed{alone} decides nothing: {usual_spread(main)}"]
    shared = " that both have" if seeds < main["seeds"].max() else ""
    shared += ", not over scenes" if is_average(place).any() else ""
    has_any = any(map(_has_interval, place.itertuples()))
    counts = sorted({int(row.seeds) for row in place.itertuples() if _has_interval(row)})
    times = "; those of times leave out what a repeated run changes" * any(
        row.metric == HOURS.name and _has_interval(row) for row in place.itertuples()
    )
    over = f"{' or '.join(map(str, counts))} seeds{shared}{times}"
    return [f"in brackets: 95 % intervals over {over}"] if has_any else []


def _published_time(pair: methods.MethodPair, scenes: pd.DataFrame) -> list[str]:
    """Return the ratio of training times by the published table, over the same scenes; nothing where it lacks one."""
    timed = scenes[scenes["metric"] == HOURS.name]
    table = published_main()
    hours = table[table["metric"] == HOURS.name].merge(timed[["dataset", "scene"]], on=["dataset", "scene"])
    means = hours.groupby("method")["value"].agg(["mean", "size"])
    if not set(pair) <= set(means.index) or timed.empty or (means["size"] < len(timed)).any():
        return []
    return [f"by the published table time × {means['mean'][pair.method] / means['mean'][pair.baseline]:.2f}"]


def is_average(rows: pd.DataFrame) -> pd.Series:
    return rows["scene"].isin((AVERAGE, OVERALL))


def why_not(rows: pd.DataFrame, otherwise: str) -> str:
    """Return why nothing can be said of some rows. otherwise: what to say if several reasons, or none, are known."""
    reasons = list(dict.fromkeys(rows.loc[rows["value"].isna(), "reason"])) if rows["value"].isna().all() else []
    if reasons == [NO_RECORD]:
        return "no scene is on disk, or none was run"
    return str(reasons[0]) if len(reasons) == 1 else otherwise


def _p(value: float) -> str:
    return "" if pd.isna(value) else " (p < 0.001)" if value < 0.001 else f" (p = {value:.2g})"

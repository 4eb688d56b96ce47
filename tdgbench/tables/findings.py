"""What was found, in sentences: the last lines on the terminal, findings.txt, and the beginning of the report.

They count what the tables hold. Nothing is computed or judged here.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.scenes.registry import DATASETS, is_built_in
from tdgbench.tables import methods
from tdgbench.tables.claims.evidence import FAILS, HOLDS, THE_PAPER, JudgedClaim
from tdgbench.tables.claims.evidence import UNDECIDED as UNDECIDED_CLAIM
from tdgbench.tables.comparisons import COUNTED, EQUAL, MethodComparison, margin_of, may_be_within_margin
from tdgbench.tables.equal_data import Place, equal_data_notes
from tdgbench.tables.grids import ERROR
from tdgbench.tables.likeness import TRAINING_KIND, is_selected, times_at_once
from tdgbench.tables.long_table import NO_RECORD, method_label, planned_iterations
from tdgbench.tables.measures import (
    ABLATION,
    AVERAGE,
    HOURS,
    MAIN_COLUMNS,
    MAIN_SCORES,
    OVERALL,
    as_text,
    digits,
    measure_of,
)
from tdgbench.tables.published import published_main
from tdgbench.tables.readings import change_as_text, widest_average, with_setup
from tdgbench.tables.seed_spreads import beyond_in_words, usual_spread
from tdgbench.tables.statistics import telling_digits, with_interval
from tdgbench.tables.verdicts import (
    NOT_REPRODUCED,
    ONE_SEED,
    REPRODUCED,
    UNDECIDED,
    UNLIKE,
    WORDS,
    comparable,
    seeds_in_words,
    unlike_published,
)
from tdgbench.text import named, one_line

TOLD = (*MAIN_COLUMNS, ERROR)  # measures
SEEDS = "seed=0,1,2"  # what one seed's verdicts need first
BEFORE_A_PLATEAU = (
    "All trainings ended by their number of iterations, not at a plateau of the loss; longer ones may differ"
)


def findings_of_methods(
    main: pd.DataFrame,
    difference: pd.DataFrame | None,
    comparisons: Sequence[MethodComparison],
    effects: pd.DataFrame | None,
    equal: Mapping[Place, Place],
    records: Sequence[Record] = (),
) -> list[str]:
    """Return the findings of a main table, one sentence each, in one line each.

    equal: from `equal_scenes`. records: of the finished cells.
    """
    if effects is None:
        sentences = [sentence for comparison in comparisons for sentence in _comparison(comparison, main, records)]
    else:  # which compare the same methods, and others
        sentences = [*_effects(effects), *given_priors(records)]
    sentences += [] if difference is None else [published(difference)]
    sentences = sentences or list(_alone(main, records))
    notes = (*_caveats(main, records), *equal_data_notes(equal)) if sentences else ()
    return [one_line(sentence) for sentence in (*sentences, *notes)]


def findings_of_ablation(
    main: pd.DataFrame, difference: pd.DataFrame | None, records: Sequence[Record] = ()
) -> list[str]:
    """Return the findings of an ablation, in the same form."""
    sentences = [*_ablation(main), *given_priors(records), *([] if difference is None else [published(difference)])]
    return [one_line(sentence) for sentence in sentences]


def _caveats(main: pd.DataFrame, records: Sequence[Record]) -> Iterable[str]:
    """Yield what the findings of a main table are no evidence of."""
    yield from before_a_plateau(records)
    scenes = main[~_is_average(main)]
    once = f"one seed decides nothing: {_more_seeds(records)}" if scenes["seeds"].max() == 1 else ""
    data_sets, known = set(scenes["dataset"]), list(records)
    if all(one.is_of_built_in_scene for one in known) if known else all(map(is_built_in, data_sets)):
        what = "These scenes are built in, so this is no evidence on the paper's claims"
    else:
        what = "" if data_sets & set(DATASETS.values()) else "tdgbench has no published scores of these scenes"
    if what:
        yield f"{what}, and {once}" if once else what


def _more_seeds(records: Sequence[Record]) -> str:
    """Return how to get more seeds: those of renders are trained elsewhere."""
    are_renders = {record.made_elsewhere is not None for record in records} or {False}
    ways = {False: f"run `{SEEDS}`", True: "score renders of further trainings, each with its `seed`"}
    return ", and ".join(ways[elsewhere] for elsewhere in sorted(are_renders))


def before_a_plateau(records: Iterable[Record]) -> list[str]:
    """Return the caveat on trainings that all ended by their budget, in a list; those of others are not known."""
    trained = [record for record in records if record.made_elsewhere is None]
    return [BEFORE_A_PLATEAU] if trained and all(map(ended_by_its_budget, trained)) else []


def ended_by_its_budget(record: Record) -> bool:
    """Return whether a training could have ended at a plateau, and ran all of its iterations."""
    could_end = any(skip["name"] == "plateau" and skip["allowed"] for skip in record.skips)
    return could_end and record.iterations == planned_iterations(record)


def published(differences: pd.DataFrame) -> str:
    """Say how many published scores are reproduced, and what would decide the others. differences: difference.csv."""
    judged, unlike = comparable(differences), unlike_published(differences)
    known = judged[judged["difference"].notna()]
    setups = named(unlike["undecided_because"].str.removeprefix(f"{UNLIKE}: "))
    if known.empty and setups:
        return f"None of the {len(judged) + len(unlike)} published scores is judged: {UNLIKE} ({setups})"
    if known.empty:
        return f"None of the {len(judged)} published scores is compared: there are no results of their scenes"
    counts = known["verdict"].value_counts().reindex(WORDS, fill_value=0)
    parts = [f"{counts[REPRODUCED]} of {len(known)} published scores reproduced"]
    parts += [f"{counts[word]} {word}" for word in WORDS if word != REPRODUCED and counts[word]]
    undecided = known[known["verdict"] == UNDECIDED]
    decidable = undecided[undecided["undecided_because"] != ONE_SEED]
    advice = [seeds_in_words(decidable)] if len(decidable) else []
    advice += [f"run `{SEEDS}`"] if len(decidable) < len(undecided) else []
    notes = [f"{len(judged) - len(known)} more have none of ours beside them"] if len(known) < len(judged) else []
    notes += [f"{len(unlike)} are not judged: {UNLIKE} ({setups})"] if setups else []
    notes += (
        [beyond_in_words(known.loc[known["verdict"] == NOT_REPRODUCED, "metric"])] if counts[NOT_REPRODUCED] else []
    )
    text = ", ".join(parts) + (f": {'; '.join(advice)}" if advice else "")
    return f"{text} ({'; '.join(notes)})" if notes else text


def claims_in_words(claims: Sequence[JudgedClaim]) -> list[str]:
    """Say how many of the paper's claims hold, and of those of other papers."""
    of_paper = [claim for claim in claims if claim.paper == THE_PAPER]
    others = [claim for claim in claims if claim.paper != THE_PAPER]
    counted = [
        ("By the published tables", [claim.published for claim in of_paper], "the paper's"),
        ("By our results", [claim.ours for claim in of_paper], "the paper's"),
        ("By our results", [claim.ours for claim in others], "other papers'"),
    ]
    return [
        f"{evidence}, {verdicts.count(HOLDS)} of {whose} {len(verdicts)} claims hold, {verdicts.count(FAILS)} fail, "
        f"{verdicts.count(UNDECIDED_CLAIM)} are undecided"
        for evidence, verdicts, whose in counted
        if verdicts
    ]


def _comparison(comparison: MethodComparison, main: pd.DataFrame, records: Sequence[Record]) -> Iterable[str]:
    """Compare a method with its baseline: on how many scenes it is better, and by how much on the widest average."""
    pair, changes, paired = comparison
    title = " against ".join(_title(column, records) for column in pair)
    both = main[main["method"].isin(pair) & main["metric"].isin(TOLD)]
    rows = changes[changes["metric"].isin(TOLD) & changes["scene"].isin(both["scene"])].dropna(subset="change")
    scenes = rows[~_is_average(rows)]
    if scenes.empty:
        kinds = both.loc[both["metric"] == MAIN_COLUMNS[0], TRAINING_KIND].unique()
        unlike = f"trainings differ ({' / '.join(filter(None, kinds))})"
        yield f"{title}: not compared: {_why_not(both, unlike if len(kinds) > 1 else 'no scene has results of both')}"
        return
    compared = scenes[["dataset", "scene"]].drop_duplicates()
    several = len(compared) > 1
    without = len(both.loc[~_is_average(both), ["dataset", "scene"]].drop_duplicates()) - len(compared)
    notes = [f"n/a on {without} more"] if without else []
    timed = both.loc[(both["metric"] == HOURS.name) & both["value"].notna(), "method"].nunique() == len(pair)
    is_timed = HOURS.name in set(scenes["metric"])
    times = _times(pair, records) if is_timed else [_why_no_times(changes)] * timed
    if several and scenes["seeds"].max() > 1:
        has_p = paired.loc[paired["metric"].isin(TOLD), "p"].notna().any()
        tests = ["p: Wilcoxon's signed-rank test over scenes, one-sided: the method is better"] if has_p else []
        yield "; ".join([f"{title} on {len(compared)} scenes: {_counts(paired, scenes)}", *tests, *times, *notes])
        notes = []
    place = widest_average(rows) if several else scenes
    if several and not _is_average(place).all():  # some scene lacks results, so there is no average
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
    rows = changes[(changes["metric"] == HOURS.name) & ~_is_average(changes)]
    return f"times are not compared: {' or '.join(dict.fromkeys(rows['reason']))}"


def _range(scenes: pd.DataFrame) -> list[str]:
    """Return how far the changes of single scenes in the first score are apart. scenes: changes."""
    metric = MAIN_SCORES[0]
    changes, measure = scenes.loc[scenes["metric"] == metric, "change"], measure_of(metric)
    ends = [f"{change:+.{digits(metric)}f}" for change in (changes.min(), changes.max())]
    return [f"{measure.label} of single scenes {' to '.join(ends)}{measure.suffix}"] if len(changes) else []


def _title(column: str, records: Sequence[Record]) -> str:
    """Return a method's name, with what else its scores come from: more than thermal images, or a choice by them."""
    cells = [one for one in records if method_label(one, with_init=True) == column]
    sources = " or ".join(filter(None, dict.fromkeys(cell.prior_source.in_full for cell in cells)))
    selected = " (checkpoint chosen by test views: its scores are too high)" * any(map(is_selected, cells))
    prior = f" with a depth prior made from {sources}" if sources else ""
    doubted = " (doubted: see the doubts)" * any(one.has_doubts_of_its_own for one in cells)
    return methods.label(column) + prior + selected + doubted


def _times(columns: Iterable[str], records: Sequence[Record]) -> list[str]:
    """Return the note on times of some columns, in a list; empty if each cell ran alone."""
    columns = list(columns)
    return times_at_once(record for record in records if method_label(record, with_init=True) in columns)


def given_priors(records: Iterable[Record]) -> list[str]:
    """Return sentences on what depth priors are made from, if not from the thermal images alone."""
    found: dict[str, list[str]] = {}
    for record in records:
        found.setdefault(record.prior_source.in_full, []).append(methods.label(record.method))
    return [f"The depth prior of {named(them)} is made from {source}" for source, them in found.items() if source]


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
    shared += ", not over scenes" if _is_average(place).any() else ""
    has_any = any(map(_has_interval, place.itertuples()))
    counts = sorted({int(row.seeds) for row in place.itertuples() if _has_interval(row)})
    times = "; those of times leave out what a repeated run changes" * (HOURS.name in set(place["metric"]))
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


def _is_average(rows: pd.DataFrame) -> pd.Series:
    return rows["scene"].isin((AVERAGE, OVERALL))


def _alone(main: pd.DataFrame, records: Sequence[Record]) -> Iterable[str]:
    """Yield the scores of each method, where nothing is compared."""
    for column, rows in main.groupby("method", sort=False):
        known = widest_average(rows[rows["metric"].isin(TOLD)]).dropna(subset="value")
        parts = [
            f"{(measure := measure_of(r.metric)).label} {as_text(r.metric, r.value, r.scene)}{measure.suffix}"
            for r in known.itertuples()
        ]
        scenes = list(dict.fromkeys(rows.loc[~_is_average(rows), "scene"]))
        where = scenes[0] if len(scenes) == 1 else f"average over {len(scenes)} scenes"
        if parts:
            notes = [*_times([str(column)], records), "no baseline was run, so it is compared with nothing"]
            yield "; ".join([f"{_title(str(column), records)} on {where}: {', '.join(parts)}", *notes])


def _ablation(main: pd.DataFrame) -> Iterable[str]:
    """Yield each method's scores by initial points, and which are best as far as seeds tell. main: an ablation."""
    for method, group in main.groupby("method", sort=False):
        parts = []
        for metric in (metric for metric in ABLATION if metric in MAIN_SCORES):
            values = group[group["metric"] == metric].dropna(subset="value").sort_values("value", ascending=False)
            best = "" if not values["bold"].any() else " (best)" if values["bold"].sum() == 1 else " (among the best)"
            if len(values):
                texts = (
                    f"{as_text(metric, r.value, OVERALL)} with {r.init}{best * r.bold}" for r in values.itertuples()
                )
                parts.append(f"{measure_of(metric).label} {', '.join(texts)}")
        parts += ["one seed decides nothing"] * bool(parts and group["seeds"].max() == 1)
        yield f"{methods.label(str(method))}: {'; '.join(parts) or 'n/a: ' + _why_not(group, 'scenes lack results')}"


def _effects(effects: pd.DataFrame) -> Iterable[str]:
    """Yield the changes that raise or lower the first published score. effects: from `readings.effects`."""
    metric = MAIN_SCORES[0]
    rows = with_setup(widest_average(effects), "effect")
    rows = rows[rows["metric"] == metric]
    label = measure_of(metric).change
    for words, chosen in (
        (f"{label}, rises with", rows["ci95_low"] > 0),
        (f"{label}, falls with", rows["ci95_high"] < 0),
    ):
        changes = [f"{r.effect}, {r.iterations} iterations: {change_as_text(r)}" for r in rows[chosen].itertuples()]
        if changes:
            yield f"{words} {'; '.join(changes)}"
    alone, open_ = rows["ci95_low"].isna().sum(), ((rows["ci95_low"] <= 0) & (rows["ci95_high"] >= 0)).sum()
    if open_:
        yield f"{label}: the 95 % interval contains 0 for {_changes(open_)}"
    if alone:
        yield f"{label}: no interval, of one seed, for {_changes(alone)}: run `{SEEDS}`"


def _changes(number: int) -> str:
    return f"{number} {'change' if number == 1 else 'changes'}"


def _why_not(rows: pd.DataFrame, otherwise: str) -> str:
    """Return why nothing can be said of some rows. otherwise: what to say if several reasons, or none, are known."""
    reasons = list(dict.fromkeys(rows.loc[rows["value"].isna(), "reason"])) if rows["value"].isna().all() else []
    if reasons == [NO_RECORD]:
        return "no scene is on disk, or none was run"
    return str(reasons[0]) if len(reasons) == 1 else otherwise


def _p(value: float) -> str:
    return "" if pd.isna(value) else " (p < 0.001)" if value < 0.001 else f" (p = {value:.2g})"

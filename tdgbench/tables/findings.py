"""What was found, in sentences: the last lines on the terminal, findings.txt, and the beginning of the report.

They count what the tables hold. Nothing is computed or judged here.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import pandas as pd

from tdgbench.cells.record import Record
from tdgbench.scenes.registry import DATASETS, is_built_in
from tdgbench.tables import methods
from tdgbench.tables.claims.evidence import FAILS, HOLDS, THE_PAPER, JudgedClaim
from tdgbench.tables.claims.evidence import UNDECIDED as UNDECIDED_CLAIM
from tdgbench.tables.comparison_sentences import TOLD, is_average, sentences_of, times_of, title_of, why_not
from tdgbench.tables.comparisons import MethodComparison
from tdgbench.tables.equal_data import Place, equal_data_notes
from tdgbench.tables.long_table import planned_iterations
from tdgbench.tables.measures import ABLATION, MAIN_SCORES, OVERALL, as_text, measure_of
from tdgbench.tables.readings import change_as_text, widest_average, with_setup
from tdgbench.tables.seed_spreads import beyond_in_words
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
        sentences = [sentence for comparison in comparisons for sentence in sentences_of(comparison, main, records)]
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
    scenes = main[~is_average(main)]
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


def given_priors(records: Iterable[Record]) -> list[str]:
    """Return sentences on what depth priors are made from, if not from the thermal images alone."""
    found: dict[str, list[str]] = {}
    for record in records:
        found.setdefault(record.prior_source.in_full, []).append(methods.label(record.method))
    return [f"The depth prior of {named(them)} is made from {source}" for source, them in found.items() if source]


def _alone(main: pd.DataFrame, records: Sequence[Record]) -> Iterable[str]:
    """Yield the scores of each method, where nothing is compared."""
    for column, rows in main.groupby("method", sort=False):
        known = widest_average(rows[rows["metric"].isin(TOLD)]).dropna(subset="value")
        parts = [
            f"{(measure := measure_of(r.metric)).label} {as_text(r.metric, r.value, r.scene)}{measure.suffix}"
            for r in known.itertuples()
        ]
        scenes = list(dict.fromkeys(rows.loc[~is_average(rows), "scene"]))
        where = scenes[0] if len(scenes) == 1 else f"average over {len(scenes)} scenes"
        if parts:
            notes = [*times_of([str(column)], records), "no baseline was run, so it is compared with nothing"]
            yield "; ".join([f"{title_of(str(column), records)} on {where}: {', '.join(parts)}", *notes])


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
        yield f"{methods.label(str(method))}: {'; '.join(parts) or 'n/a: ' + why_not(group, 'scenes lack results')}"


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

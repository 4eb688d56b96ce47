"""What was found, in sentences: the last lines on the terminal, findings.txt, and the beginning of the report.

They count what the tables hold. Nothing is computed or judged here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import pandas as pd

from tdgbench.scenes.registry import DATASETS
from tdgbench.tables import methods
from tdgbench.tables.claims.evidence import FAILS, HOLDS, THE_PAPER, JudgedClaim
from tdgbench.tables.claims.evidence import UNDECIDED as UNDECIDED_CLAIM
from tdgbench.tables.long_table import NO_RECORD
from tdgbench.tables.measures import ABLATION, AVERAGE, MEASURES, OVERALL, PUBLISHED, PUBLISHED_SCORES, as_text
from tdgbench.tables.readings import change_as_text, widest_average, with_setup
from tdgbench.tables.statistics import MethodComparison
from tdgbench.tables.verdicts import ONE_SEED, REPRODUCED, UNDECIDED, WORDS, comparable, seeds_in_words
from tdgbench.text import one_line

SYNTHETIC, CAPTURE = "synthetic", "folder"  # data sets; the first begins the names of several
SEEDS = "seed=0,1,2"  # what one seed's verdicts need first


def findings_of_methods(
    main: pd.DataFrame,
    difference: pd.DataFrame | None,
    comparisons: Iterable[MethodComparison],
    effects: pd.DataFrame | None,
) -> list[str]:
    """Return the findings of a main table, one sentence each, in one line each."""
    sentences = [sentence for comparison in comparisons for sentence in _comparison(comparison, main)]
    sentences += [] if effects is None else _effects(effects)
    sentences += [] if difference is None else [published(difference)]
    sentences = sentences or list(_alone(main))
    return [one_line(sentence) for sentence in (*sentences, *(_caveats(main) if sentences else ()))]


def findings_of_ablation(main: pd.DataFrame, difference: pd.DataFrame | None) -> list[str]:
    """Return the findings of an ablation, in the same form."""
    sentences = [*_ablation(main), *([] if difference is None else [published(difference)])]
    return [one_line(sentence) for sentence in sentences]


def _caveats(main: pd.DataFrame) -> Iterable[str]:
    """Yield what the findings of a main table are no evidence of."""
    scenes = main[~main["scene"].isin((AVERAGE, OVERALL))]
    once = f"one seed decides nothing: run `{SEEDS}`" if scenes["seeds"].max() == 1 else ""
    data_sets = set(scenes["dataset"])
    if data_sets == {CAPTURE}:
        what = "These scenes are your capture, so no published score is beside them"
    elif all(name.startswith(SYNTHETIC) for name in data_sets):
        what = "These scenes are built in, so this is no evidence on the paper's claims"
    else:
        what = "" if data_sets & set(DATASETS.values()) else "No published score is beside these scenes"
    if what:
        yield f"{what}, and {once}" if once else what


def published(differences: pd.DataFrame) -> str:
    """Say how many published scores are reproduced, and what would decide the others. differences: difference.csv.

    With one seed, every verdict waits for more seeds.
    """
    judged = comparable(differences)
    known = judged[judged["difference"].notna()]
    if known.empty:
        return f"Published scores: n/a: none of the {len(judged)} has one of ours beside it"
    counts = known["verdict"].value_counts().reindex(WORDS, fill_value=0)
    parts = [f"{counts[REPRODUCED]} of {len(known)} published scores reproduced"]
    parts += [f"{counts[word]} {word}" for word in WORDS if word != REPRODUCED and counts[word]]
    undecided = known[known["verdict"] == UNDECIDED]
    decidable = undecided[undecided["undecided_because"] != ONE_SEED]
    advice = [seeds_in_words(decidable)] if len(decidable) else []
    advice += [f"run `{SEEDS}`"] if len(decidable) < len(undecided) else []
    missing = f" ({len(judged) - len(known)} more have none of ours beside them)" if len(known) < len(judged) else ""
    return ", ".join(parts) + (f": {'; '.join(advice)}" if advice else "") + missing


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


def _comparison(comparison: MethodComparison, main: pd.DataFrame) -> Iterable[str]:
    """Compare a method with its baseline: scenes, averages, training time."""
    pair, paired, speed = comparison
    both = main[main["method"].isin(pair) & main["metric"].isin(PUBLISHED)]
    if both["method"].nunique() < 2:
        return
    method, baseline = methods.label(pair.method), methods.label(pair.baseline)
    rows = [row for row in paired.itertuples() if row.metric in PUBLISHED and row.scenes]
    if not rows:
        yield f"{method} against {baseline}: {_why_not(both, 'no scene has results of both')}"
        return
    counts = [
        f"{row.better} of {row.scenes}{' scenes' * (row is rows[0])} in {MEASURES[row.metric].label}{_p(row.p)}"
        for row in rows
    ]
    notes = ["p: Wilcoxon's signed-rank test over the scenes"] if any(_p(row.p) for row in rows) else []
    scenes = both.loc[~both["scene"].isin((AVERAGE, OVERALL)), ["dataset", "scene"]].drop_duplicates()
    without = len(scenes) - rows[0].scenes
    notes += [f"n/a on {without} more"] if without else []
    yield "; ".join([f"{method} is better than {baseline} on {', '.join(counts)}", *notes])
    if rows[0].scenes > 1:
        yield from _averages(pair, both)
    of_scenes = speed[~speed["scene"].isin((AVERAGE, OVERALL))].dropna()
    if len(of_scenes):
        ratio = of_scenes["ours"] / of_scenes["published"]
        ours, paper = of_scenes["ours"].mean(), of_scenes["published"].mean()
        yield (
            f"{method} takes {ours:.2f} times as long as {baseline}, by the published table {paper:.2f} times; "
            f"{int((ratio - 1).abs().lt(0.1).sum())} of {len(of_scenes)} scenes agree within 10 %"
        )


def _alone(main: pd.DataFrame) -> Iterable[str]:
    """Yield the scores of each method, where nothing is compared."""
    for column, rows in main.groupby("method", sort=False):
        known = widest_average(rows[rows["metric"].isin(PUBLISHED)]).dropna(subset="value")
        parts = [f"{MEASURES[r.metric].label} {as_text(r.metric, r.value, r.scene)}" for r in known.itertuples()]
        scenes = list(dict.fromkeys(rows.loc[~rows["scene"].isin((AVERAGE, OVERALL)), "scene"]))
        where = scenes[0] if len(scenes) == 1 else f"the average of {len(scenes)} scenes"
        if parts:
            yield f"{methods.label(str(column))} has {', '.join(parts)} on {where}, with no baseline beside it"


def _averages(pair: methods.MethodPair, both: pd.DataFrame) -> Iterable[str]:
    """Yield the widest averages of a method beside those of its baseline; nothing where they are n/a."""
    known = widest_average(both).dropna(subset="value")
    texts = {(r.method, r.metric): as_text(r.metric, r.value, r.scene) for r in known.itertuples()}
    parts = [
        f"{MEASURES[metric].label} {texts[pair.method, metric]} against {texts[pair.baseline, metric]}"
        for metric in PUBLISHED
        if {(method, metric) for method in pair} <= set(texts)
    ]
    if parts:
        yield f"On average {methods.label(pair.method)} has {', '.join(parts)}"


def _ablation(main: pd.DataFrame) -> Iterable[str]:
    """Yield the initial points with which each method scores best. main: an ablation."""
    for method, group in main.groupby("method", sort=False):
        parts = []
        for metric in (metric for metric in ABLATION if metric in PUBLISHED_SCORES):
            values = group[group["metric"] == metric].dropna(subset="value").sort_values("value", ascending=False)
            if len(values):
                texts = (f"{as_text(metric, r.value, OVERALL)} with {r.init}" for r in values.itertuples())
                parts.append(f"{MEASURES[metric].label} {', '.join(texts)}")
        label = methods.label(str(method))
        what = f", best points first: {'; '.join(parts)}" if parts else f": {_why_not(group, 'scenes lack results')}"
        yield f"{label}{what}"


def _effects(effects: pd.DataFrame) -> Iterable[str]:
    """Yield the changes that raise or lower the first published score. effects: from `readings.effects`."""
    metric = PUBLISHED_SCORES[0]
    rows = with_setup(widest_average(effects), "effect")
    rows = rows[rows["metric"] == metric]
    label = MEASURES[metric].change
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
        return "n/a: no scene is on disk, or none was run"
    return f"n/a: {reasons[0] if len(reasons) == 1 else otherwise}"


def _p(value: float) -> str:
    return "" if pd.isna(value) else " (p < 0.001)" if value < 0.001 else f" (p = {value:.2g})"

"""Methods against one another over equal seeds: against a baseline, scene by scene, and against the best of a row.

A difference is `equal` where its 95 % Student interval over the seeds that both have lies within the margin up to which
scores count as equal (`margins.yaml`; half a unit of print for the others), else `better` or `worse` where the interval
excludes 0, though it may reach inside the margin. Anything else is `undecided`; one seed decides nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tdgbench.scenes.inputs import ROWS_OF_AVERAGES
from tdgbench.tables import methods
from tdgbench.tables.equal_data import Place
from tdgbench.tables.likeness import was_disturbed
from tdgbench.tables.long_table import method_label
from tdgbench.tables.measures import HOURS, KEYS, MAIN_COLUMNS, gain, half_unit, is_of_training, measure_of
from tdgbench.tables.methods import MethodPair
from tdgbench.tables.palette import IMAGES, values_over_scenes
from tdgbench.tables.results import Cell
from tdgbench.tables.statistics import mean_interval, seed_values
from tdgbench.tables.verdicts import BETTER, NEVER, UNDECIDED, WORSE, load_margins

EQUAL = "equal"  # beside the verdicts on published numbers
COUNTED = (BETTER, WORSE, EQUAL, UNDECIDED)
FEWEST_SEEDS = 3  # of bold type; of two, an interval is 13 standard errors wide on each side
OPEN = "whether by more than the margin is undecided"  # reason beside a verdict
CHANGE_IS = {False: "difference", True: "ratio"}
FEWEST_SCENES = 5  # of a test over scenes: with fewer, no outcome could be below 5 %


def margins_in_words() -> str:
    """Return the differences of scores that count as equal, as `margins.yaml` has them."""
    known = [(measure_of(name), margin) for name, margin in load_margins().items()]
    return ", ".join(f"{one.label} {margin:g}{one.suffix}" for one, margin in known)


def bold_note() -> str:
    """Return what bold type in tables means."""
    return (
        "bold: the best, and all whose difference from it has an interval (95 %, over seeds) that includes 0 or lies "
        f"within the margin ({margins_in_words()}; of other scores half a unit of print, of times none), over "
        f"the seeds that all methods have; none with fewer than {FEWEST_SEEDS}"
    )


class Change(NamedTuple):
    """Change from a baseline to a method over the seeds that both have.

    new, old: means of the method and of its baseline (NaN without a common seed). change: the mean difference, or for
    times and sizes the ratio. ci95: its interval, NaN for one seed. verdict: on the method.
    """

    new: float
    old: float
    change: float
    ci95_low: float
    ci95_high: float
    seeds: int
    verdict: str


class MethodComparison(NamedTuple):
    """A method against its baseline. paired: from `paired_tests`.

    changes: KEYS but method, fields of Change with what `change` is, a reason where there is no common seed and the
    verdict is n/a, or where a sure change may lie within the margin, and `image_values` of the method.
    """

    pair: MethodPair
    changes: pd.DataFrame
    paired: pd.DataFrame


def may_be_within_margin(change: Any) -> bool:
    """Return whether a change has a sign for certain, but may lie within the margin. change: a row of `changes`."""
    is_sure = change.verdict in (BETTER, WORSE)
    return is_sure and min(abs(change.ci95_low), abs(change.ci95_high)) < margin_of(change.metric)


def margin_of(metric: str) -> float:
    """Return the difference up to which two scores count as equal: of published ones, else print's; of ratios 0."""
    return 0.0 if measure_of(metric).ratio else load_margins().get(metric, half_unit(metric))


def change_over_seeds(metric: str, new: np.ndarray, old: np.ndarray) -> Change:
    """Compare two methods' numbers (N,), by seed; NaN where a seed is missing.

    >>> change_over_seeds("psnr", np.array([21.0, 21.4, 21.2]), np.array([20.0, 20.2, 20.1])).verdict
    'better'
    >>> change_over_seeds("psnr", np.array([21.0]), np.array([20.0])).verdict
    'undecided'
    """
    ratio = measure_of(metric).ratio
    with np.errstate(invalid="ignore", divide="ignore"):
        values = np.log(new / old) if ratio else new - old
    both = np.isfinite(values)
    if not both.any():
        nan = float("nan")
        return Change(nan, nan, nan, nan, nan, 0, UNDECIDED)
    mean, low, high = mean_interval(values[both])
    margin = margin_of(metric)
    is_equal, has_sign = -margin <= low and high <= margin, low > 0 or high < 0
    verdict = EQUAL if is_equal else UNDECIDED if not has_sign else BETTER if gain(metric, mean, 0.0) > 0 else WORSE
    mean, low, high = np.exp([mean, low, high]).tolist() if ratio else (mean, low, high)
    return Change(float(new[both].mean()), float(old[both].mean()), mean, low, high, int(both.sum()), verdict)


def best_or_tied(metric: str, values: np.ndarray, by_seed: np.ndarray) -> np.ndarray:
    """Return whether each method (N,) bool is the best, or cannot be told from it: those that a table prints bold.

    values: means (N,), NaN for n/a. by_seed: (N, S), NaN where a method lacks the seed. Only seeds that all methods
    with a mean have count; with less than FEWEST_SEEDS of them, none is.

    >>> seeds = np.array([[20.0, 20.2, 20.1], [30.0, 30.1, 30.0], [30.0, 30.3, 30.1]])
    >>> best_or_tied("psnr", seeds.mean(axis=1), seeds).tolist()
    [False, True, True]
    """
    known = np.flatnonzero(~np.isnan(values))
    marks = np.zeros(len(values), dtype=bool)
    if len(known) < 2 or not measure_of(metric).has_better_side or is_of_training(metric):
        return marks
    shared = by_seed[:, np.isfinite(by_seed[known]).all(axis=0)]
    if shared.shape[1] < FEWEST_SEEDS:
        return marks
    best = max(known, key=lambda i: gain(metric, shared[i].mean(), 0.0))
    verdicts = {i: change_over_seeds(metric, shared[i], shared[best]).verdict for i in known if i != best}
    marks[[best, *(i for i, verdict in verdicts.items() if verdict in (EQUAL, UNDECIDED))]] = True
    return marks


def with_bold(rows: pd.DataFrame, by_seed: pd.DataFrame, within: Sequence[str]) -> pd.DataFrame:
    """Return the rows with the column `bold`: which are `best_or_tied` among those of equal metric and `within`.

    by_seed: the rows' values by seed, with their index. None is where values are of unlike trainings (column
    `training`): a reader takes the bold one for the best of its row.
    """
    bold = pd.Series(False, rows.index)
    for _, rivals in rows.groupby([*within, "metric"], sort=False):
        if "training" in rows and rivals.loc[rivals["value"].notna(), "training"].nunique() > 1:
            continue
        values, seeds = rivals["value"].to_numpy(float), by_seed.loc[rivals.index].to_numpy(float)
        bold[rivals.index] = best_or_tied(rivals["metric"].iloc[0], values, seeds)
    return rows.assign(bold=bold)


def compare_methods(
    cells: pd.DataFrame, main: pd.DataFrame, finished: Sequence[Cell], equal: Collection[Place] = ()
) -> list[MethodComparison]:
    """Compare every method of a main table with its baseline (`methods.baselines`), where the table has both.

    cells: `cell_rows`. finished: the cells behind them. equal: scenes of the data of others (`equal_scenes`), which do
    not count. Nor do those of unlike trainings (column `training` of main), nor what is n/a in main, such as a mean
    over seeds of which some failed, nor times of two machines, seed by seed.
    """
    once = [place not in equal for place in zip(cells["dataset"], cells["scene"], strict=True)]
    sided = [name for name in cells["metric"].unique() if measure_of(name).has_better_side and not is_of_training(name)]
    counted = cells[np.array(once, dtype=bool) & cells["metric"].isin(sided)]
    scored = main.loc[main["metric"].isin(MAIN_COLUMNS) & main["value"].notna(), "method"].unique()
    # a baseline without scores is compared with only where no pair has them, to say why
    pairs = methods.baselines(scored) or methods.baselines(main["method"].unique())
    return [_compare(pair, counted, main, finished) for pair in pairs]


def _compare(pair: MethodPair, cells: pd.DataFrame, main: pd.DataFrame, finished: Sequence[Cell]) -> MethodComparison:
    both, unlike = cells[cells["method"].isin(pair)], _unlike(pair, main, finished)
    places = zip(both["dataset"], both["scene"], both["seed"], both["metric"] == HOURS.name, strict=True)
    dropped = np.array([(d, s) in unlike or (timed and (d, s, seed) in unlike) for d, s, seed, timed in places], bool)
    by_seed = seed_values(both.assign(value=both["value"].where(~dropped)))
    printed = main[KEYS[1:]].drop_duplicates()  # a table of one data set has no overall average
    new, old = (by_seed.xs(method, level="method") for method in pair)
    new, old = (side[side.index.isin(pd.MultiIndex.from_frame(printed))] for side in (new, old))
    has_mean, missing = main.set_index(KEYS)["value"].notna(), np.full(new.shape[1], np.nan)
    rows = []
    for place in new.index:
        are_means = all(has_mean.get((method, *_scored(place)), False) for method in pair)
        sides = [side.loc[place].to_numpy(float) if are_means else missing for side in (new, old)]
        rows.append([*place, *change_over_seeds(place[-1], *sides)])
    changes = pd.DataFrame(rows, columns=[*KEYS[1:], *Change._fields])
    reasons, is_none = main.set_index(KEYS)["reason"], changes["seeds"] == 0
    values = main[main["method"] == pair.method].set_index(KEYS[1:])[IMAGES]
    changes = changes.assign(reason="", **{IMAGES: values.reindex(new.index).fillna("").to_numpy()})
    kinds = [CHANGE_IS[measure_of(place[-1]).ratio] for place in new.index]
    changes.insert(list(changes).index("change") + 1, "change_is", kinds)
    for row, place in zip(changes.index[is_none], new.index[is_none], strict=True):  # averages come after their scenes
        changes.loc[row, "reason"] = _why_none(pair, place, reasons, unlike, changes)
    changes.loc[is_none, "verdict"] = NEVER
    changes.loc[[may_be_within_margin(row) for row in changes.itertuples()], "reason"] = OPEN
    return MethodComparison(pair, changes, paired_tests(changes, main[main["method"].isin(pair)]))


def _scored(place: tuple[str, ...]) -> tuple[str, ...]:
    """Return the place whose mean says whether trainings compare there. place: KEYS but the method.

    Of times it is that of the first score: seed by seed, times of several machines may compare where their mean is n/a.
    """
    return (*place[:-1], MAIN_COLUMNS[0]) if place[-1] == HOURS.name else place


def _why_none(
    pair: MethodPair,
    place: tuple[str, ...],
    reasons: pd.Series,
    unlike: Mapping[tuple[object, ...], str],
    changes: pd.DataFrame,
) -> str:
    """Return why a pair has no seed in common. place: KEYS but the method. reasons: why a number is n/a, by KEYS.

    changes: those of scenes have their reasons, from which those of averages follow.
    """
    lacking = {method: why for method in pair
               if (why := reasons.get((method, *place), "") or reasons.get((method, *_scored(place)), ""))}  # fmt: skip
    if len(lacking) == len(pair) and len({*lacking.values()}) == 1:
        return lacking[pair.method]
    if lacking:
        return "; ".join(f"{methods.label(method)}: {why}" for method, why in lacking.items())
    dataset, _, scene, metric = place
    if scene in ROWS_OF_AVERAGES:
        return _why_no_average(changes[changes["dataset"].isin([dataset] if dataset else changes["dataset"])], metric)
    of_scene = {why: None for found, why in unlike.items() if found[:2] == (dataset, scene)}
    if (dataset, scene) in unlike:
        return unlike[dataset, scene]
    return " or ".join(of_scene) if metric == HOURS.name and of_scene else "no seed in common"


def _why_no_average(changes: pd.DataFrame, metric: str) -> str:
    """Return why an average over scenes has no seed. changes: of the scenes, and of averages, which do not count."""
    scenes = changes[(changes["metric"] == metric) & ~changes["scene"].isin(ROWS_OF_AVERAGES)]
    without = scenes[scenes["seeds"] == 0]
    if without.empty:
        return "no seed in common that every scene has"
    why = " or ".join(dict.fromkeys(without["reason"]))
    return why if len(without) == len(scenes) else f"{len(without)} of {len(scenes)} scenes: {why}"


def _unlike(pair: MethodPair, main: pd.DataFrame, finished: Sequence[Cell]) -> dict[tuple[object, ...], str]:
    """Return why by (data set, scene) of unlike trainings, and (data set, scene, seed) of times that do not compare."""
    unlike: dict[tuple[object, ...], str] = {}
    if "training" in main:
        scores = main[main["method"].isin(pair) & (main["metric"] == MAIN_COLUMNS[0])]
        kinds = scores.groupby(["dataset", "scene"])["training"].nunique()
        unlike |= dict.fromkeys(kinds.index[kinds > 1], "unlike trainings")
    machines: dict[tuple[object, ...], set[tuple[str, ...]]] = {}
    for cell in finished:
        if method_label(cell.record, with_init=True) in pair:
            place = (*cell.dataset_and_scene, cell.record.seed)
            machines.setdefault(place, set()).add(cell.machine)
            if was_disturbed(cell.record):
                unlike[place] = "times of a busy machine"
    return unlike | {place: "times of two machines" for place, found in machines.items() if len(found) > 1}


def paired_tests(changes: pd.DataFrame, main: pd.DataFrame) -> pd.DataFrame:
    """Return metric, scenes, better, worse, equal, undecided, p, image_values: over scenes, how a method compares.

    changes: of a MethodComparison. main: rows of both methods. p: of Wilcoxon's one-sided signed-rank test that the
    method is better, of the changes' means; NaN below FEWEST_SCENES.
    """
    rows = []
    for metric, group in changes[~changes["scene"].isin(ROWS_OF_AVERAGES)].groupby("metric", sort=False):
        known, p = group.dropna(subset="change"), float("nan")
        if known.empty:
            continue
        gains = gain(str(metric), np.log(known["change"]) if measure_of(str(metric)).ratio else known["change"], 0.0)
        if len(known) >= FEWEST_SCENES and (gains != 0).any():
            from scipy.stats import wilcoxon  # takes half a second to import, and most runs do without

            p = float(wilcoxon(gains, alternative="greater").pvalue)
        counts = [int((known["verdict"] == word).sum()) for word in COUNTED]
        compared = main[(main["metric"] == metric) & main["scene"].isin(known["scene"]) & main["value"].notna()]
        rows.append([metric, len(known), *counts, p, values_over_scenes(compared)])
    return pd.DataFrame(rows, columns=["metric", "scenes", *COUNTED, "p", IMAGES])


def comparison_tables(comparisons: Iterable[MethodComparison]) -> dict[str, pd.DataFrame]:
    """Return the tables `compared` (every change) and `paired` (tests over scenes) of all pairs; none without any."""
    tables: dict[str, list[pd.DataFrame]] = {"compared": [], "paired": []}
    for (method, baseline), *parts in comparisons:
        for found, part in zip(tables.values(), parts, strict=True):
            found.append(part.assign(method=method, baseline=baseline)[["method", "baseline", *part]])
    return {name: pd.concat(parts, ignore_index=True) for name, parts in tables.items() if any(map(len, parts))}

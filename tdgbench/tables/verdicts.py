"""Our numbers beside published ones, with verdicts: equivalence tests of means over seeds (two one-sided tests, TOST).

`reproduced`: the 90 % interval of our mean (Student) lies within the margin around the published number. `better`,
`worse`: it lies outside, on one side. `not reproduced`: of one seed, beyond the margin and any spread over seeds
(`seed_spreads.yaml`). `undecided`: anything else. `reproduced`, `better` and `worse` are each wrong in at most 5 % of
cases, for a number of seeds that was chosen beforehand (docs/findings/verdicts.md). A verdict holds for every number
that prints the same: half a unit narrows the margin for `reproduced` and widens it for `better` and `worse`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from omegaconf import OmegaConf
from scipy.special import stdtrit

from tdgbench.cells.record import Record
from tdgbench.tables.between_papers import with_other_papers
from tdgbench.tables.measures import HOURS, OVERALL, half_unit, measure_of
from tdgbench.tables.palette import IMAGES, with_text_of_cells
from tdgbench.tables.published import FOLDER
from tdgbench.tables.published_setup import departures
from tdgbench.tables.seed_spreads import beyond_any_seed
from tdgbench.tables.statistics import UNEQUAL_SEEDS, half_width

ALPHA = 0.05  # of each one-sided test; the interval covers 1 − 2 ALPHA
POWER = 0.8  # share of repetitions that `seeds_needed` seeds decide
MOST_SEEDS = 100
REPRODUCED, BETTER, WORSE, UNDECIDED = "reproduced", "better", "worse", "undecided"
NOT_REPRODUCED = "not reproduced"  # by one seed
WORDS = (REPRODUCED, BETTER, WORSE, NOT_REPRODUCED, UNDECIDED)
NEVER, UNKNOWN = "n/a", "unknown"
ONE_SEED = "one seed has no spread"
UNLIKE = "our cells are not of the published setup"
NUMBERS = ("ours", "published", "std", "seeds")


class ScoreVerdict(NamedTuple):
    """A verdict and its grounds.

    margin: of the metric (NaN: none). ci90: interval of our mean (NaN below two seeds). seeds_needed: a number,
    `> 100`, `n/a` (no number of seeds decides it), `unknown`, or empty (decided).
    """

    verdict: str
    margin: float
    ci90_low: float
    ci90_high: float
    seeds_needed: str
    undecided_because: str


@cache
def load_margins(path: Path = FOLDER / "margins.yaml") -> dict[str, float]:
    """Load each metric's margin, in its unit. Raises ValueError for one that is not positive or has no reason."""
    entries: dict[str, Any] = OmegaConf.to_container(OmegaConf.load(path))  # type: ignore[assignment]
    for metric, entry in entries.items():
        if not entry.get("reason") or not entry.get("margin", 0) > 0:
            raise ValueError(f"{path}: {metric} needs a margin above 0 and a reason")
    return {metric: float(entry["margin"]) for metric, entry in entries.items()}


def seeds_interval(mean: Any, std: Any, seeds: Any) -> tuple[Any, Any]:
    """Return Student's 90 % interval of a mean over seeds. std: sample standard deviation. Arrays broadcast."""
    half = half_width(std, seeds, ALPHA)
    return mean - half, mean + half


def judge_score(low: Any, high: Any, published: float, half_unit: float, margin: float, higher: bool = True) -> Any:
    """Judge intervals low … high. half_unit: of the last printed digit. higher: whether higher is better.

    >>> judge_score(np.array([24.0, 23.0, 24.1]), np.array([24.1, 23.1, 24.5]), 24.06, 0.005, 0.2).tolist()
    ['reproduced', 'worse', 'undecided']
    """
    inside = (low >= published + half_unit - margin) & (high <= published - half_unit + margin)
    above, below = low > published + half_unit + margin, high < published - half_unit - margin
    return np.select([inside, above, below], [REPRODUCED, *((BETTER, WORSE) if higher else (WORSE, BETTER))], UNDECIDED)


def seeds_needed(distance: float, std: float, half_unit: float, margin: float) -> str:
    """Return the number of seeds that would decide four of five repetitions, if distance and std are the true ones.

    distance: |our mean − published|. `n/a` where it is at the margin, to half a unit of print.

    >>> seeds_needed(distance=0.05, std=0.1, half_unit=0.005, margin=0.2)
    '5'
    """
    inner, outer = margin - half_unit, margin + half_unit
    if inner <= distance <= outer:
        return NEVER
    seeds = np.arange(2, MOST_SEEDS + 1)
    error = std / np.sqrt(seeds)
    if distance > outer:
        power = _power((distance - outer) / error, seeds)
    else:  # both one-sided tests must reject; the sum of their misses bounds the misses of both
        power = _power((inner - distance) / error, seeds) + _power((inner + distance) / error, seeds) - 1
    enough = seeds[power >= POWER]
    return str(enough[0]) if len(enough) else f"> {MOST_SEEDS}"


def _power(shift: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Return the power of a one-sided t test at a true difference of `shift` standard errors (noncentral t)."""
    from scipy.stats import nct  # takes half a second to import; few runs need it

    return nct.sf(-stdtrit(seeds - 1, ALPHA), seeds - 1, np.minimum(shift, 50.0))


def judge_published(metric: str, scene: str, ours: float, published: float, std: float, seeds: int) -> ScoreVerdict:
    """Judge one published number. ours, std: mean and sample standard deviation over seeds (std NaN for one).

    An average over scenes is judged like a scene, by the spread of averages over seeds that all scenes have; seeds: 0
    where they have unequal ones.

    >>> judge_published("psnr", "Truck", ours=26.3, published=26.28, std=0.05, seeds=3).verdict
    'reproduced'
    >>> judge_published("psnr", "Truck", ours=4.3, published=26.28, std=float("nan"), seeds=1).verdict
    'not reproduced'
    """
    nan = float("nan")
    margin = load_margins().get(metric, nan)
    if np.isnan(margin):
        why = "hours depend on the machine" if metric == HOURS.name else f"no margin is stated for {metric}"
        return ScoreVerdict(UNDECIDED, nan, nan, nan, NEVER, why)
    if np.isnan(ours):
        return ScoreVerdict(UNDECIDED, margin, nan, nan, UNKNOWN, "no number of ours")
    rounding = half_unit(metric, scene)
    if seeds < 2 or np.isnan(std):
        if beyond_any_seed(metric, abs(ours - published) - margin - rounding):
            return ScoreVerdict(NOT_REPRODUCED, margin, nan, nan, "", "")
        return ScoreVerdict(UNDECIDED, margin, nan, nan, UNKNOWN, ONE_SEED if seeds else UNEQUAL_SEEDS)
    low, high = (float(end) for end in seeds_interval(ours, std, seeds))
    word = str(judge_score(low, high, published, rounding, margin, measure_of(metric).higher_is_better))
    if word != UNDECIDED:
        return ScoreVerdict(word, margin, low, high, "", "")
    needed = seeds_needed(abs(ours - published), std, rounding, margin)
    why = "the difference is at the margin" if needed == NEVER else "the interval crosses the margin"
    return ScoreVerdict(word, margin, low, high, needed, why)


def against_published(
    main: pd.DataFrame,
    published: pd.DataFrame,
    keys: list[str],
    records: Iterable[Record],
    column: Callable[[Record], str],
) -> pd.DataFrame:
    """Return one row per published number: keys, ours, published, difference (ours − published), reason, std, seeds,
    fields of ScoreVerdict, other papers' numbers, image_values. ours: NaN where it is n/a, for the reason.

    records: behind the main table; column: of a record's method. Numbers of another setup than the published one have
    no verdict, but `n/a` with the reason.
    """
    setups = {f"setup of {metric}": partial(departures, metric=metric) for metric in load_margins()}
    published = with_text_of_cells(published, records, setups, column)
    keys_and_setups = [*keys, "value", *setups]
    ours = main[[*keys, "value", "reason", "std", "seeds", IMAGES]].rename(columns={"value": "ours"})
    merged = published[keys_and_setups].rename(columns={"value": "published"}).merge(ours, on=keys, how="left")
    merged = merged.fillna({"reason": "no such cell in our results", "seeds": 0, IMAGES: ""}).astype({"seeds": int})
    merged["difference"] = merged["ours"] - merged["published"]
    judged = [
        _unlike(row["metric"], row.get(f"setup of {row['metric']}", ""))
        or judge_published(row["metric"], row.get("scene", OVERALL), *(row[name] for name in NUMBERS))
        for row in merged.to_dict("records")
    ]
    verdicts = pd.DataFrame(judged, columns=list(ScoreVerdict._fields), index=merged.index)
    table = pd.concat([merged[[*keys, "ours", "published", "difference", "reason", "std", "seeds"]],
                       verdicts[["margin", "ci90_low", "ci90_high", "verdict", "seeds_needed", "undecided_because"]]],
                      axis=1)  # fmt: skip
    return with_other_papers(table).assign(**{IMAGES: merged[IMAGES]})


def _unlike(metric: str, setup: str) -> ScoreVerdict | None:
    """Return that a number is not judged if its cells are of another setup than the published number; else None."""
    nan = float("nan")
    return ScoreVerdict(NEVER, load_margins()[metric], nan, nan, NEVER, f"{UNLIKE}: {setup}") if setup else None


def scores_of(differences: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of difference.csv whose metric has a margin."""
    return differences[differences["metric"].isin(load_margins())]


def comparable(differences: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of difference.csv that have a verdict: of the published setup, whose metric has a margin."""
    return scores_of(differences).query("verdict != @NEVER")


def unlike_published(differences: pd.DataFrame) -> pd.DataFrame:
    """Return the rows of difference.csv that are not judged, since our cells are of another setup."""
    return scores_of(differences).query("verdict == @NEVER")


def verdicts_in_words(judged: pd.DataFrame) -> str:
    """Return counts of verdicts, and the seeds that would decide the undecided ones. judged: verdict, seeds_needed.

    >>> verdicts_in_words(pd.DataFrame({"verdict": ["reproduced", "undecided"], "seeds_needed": ["", "7"]}))
    '1 reproduced, 1 undecided (7 seeds would decide 1)'
    """
    counts = judged["verdict"].value_counts()
    words = {**{word: word for word in WORDS}, NEVER: "not judged"}
    text = ", ".join(f"{counts[word]} {said}" for word, said in words.items() if word in counts)
    needed = seeds_in_words(judged)
    return text + (f" ({needed})" if needed else "")


def seeds_in_words(judged: pd.DataFrame) -> str:
    """Return how many seeds would decide the undecided verdicts; empty if all are decided.

    >>> seeds_in_words(pd.DataFrame({"verdict": ["undecided"] * 2, "seeds_needed": ["3", "> 100"]}))
    '3 seeds would decide 1; more than 100 for 1'
    """
    needed = judged.loc[judged["verdict"] == UNDECIDED, "seeds_needed"]
    numbers = needed[needed.str.isdigit()].astype(int)
    parts = []
    if len(numbers):
        low, high = numbers.min(), numbers.max()
        parts.append(f"{low if low == high else f'{low} to {high}'} seeds would decide {len(numbers)}")
    names = {f"> {MOST_SEEDS}": f"more than {MOST_SEEDS}", NEVER: "no number of seeds", UNKNOWN: "unknown"}
    parts += [f"{name} for {(needed == key).sum()}" for key, name in names.items() if (needed == key).any()]
    return "; ".join(parts)

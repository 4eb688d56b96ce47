"""The verdict on a published number: an equivalence test of our mean over seeds (two one-sided tests, TOST).

- `reproduced`: the 90 % interval of our mean (Student, 5 % on each side) lies within the margin around the published
  number.
- `better`, `worse`: the interval lies wholly outside of the margin, on one side.
- `undecided`: anything else, with the number of seeds that would probably decide it.

Each of the first three is wrong in at most 5 % of cases (`python -m benchmarks.verdicts` shows it). Print hides up to
half a unit of the last digit, so a verdict has to hold for every number that prints the same: half a unit narrows the
margin for `reproduced` and widens it for `better` and `worse`. The published number counts as exact otherwise: no paper
says how far its number moves with the seed. The 5 % hold for a number of seeds that was chosen beforehand; adding seeds
until a verdict appears makes errors more frequent.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from omegaconf import OmegaConf
from scipy import stats

from tdgbench.tables.published import FOLDER
from tdgbench.tables.results import HIGHER_IS_BETTER, decimals
from tdgbench.tables.statistics import half_width

ALPHA = 0.05  # of each one-sided test; the interval covers 1 − 2 ALPHA
POWER = 0.8  # the share of repetitions that `seeds_needed` seeds decide
MOST_SEEDS = 100
REPRODUCED, BETTER, WORSE, UNDECIDED = "reproduced", "better", "worse", "undecided"
WORDS = (REPRODUCED, BETTER, WORSE, UNDECIDED)
NEVER, UNKNOWN = "n/a", "unknown"


class Verdict(NamedTuple):
    """A verdict and what it rests on.

    margin: as stated for the metric (NaN: none). low, high: the interval of our mean (NaN below two seeds).
    seeds_needed: a number, `> 100`, `n/a` (no number of seeds decides it), `unknown`, or empty (it is decided).
    why: why it is undecided; else empty.
    """

    word: str
    margin: float
    low: float
    high: float
    seeds_needed: str
    why: str


@cache
def load_margins(path: Path = FOLDER / "margins.yaml") -> dict[str, float]:
    """The margin of each metric, in its unit. Raises ValueError for one that is not positive or has no reason."""
    found: dict[str, Any] = OmegaConf.to_container(OmegaConf.load(path))  # type: ignore[assignment]
    for metric, entry in found.items():
        if not entry.get("reason") or not entry.get("margin", 0) > 0:
            raise ValueError(f"{path}: {metric} needs a margin above 0 and a reason")
    return {metric: float(entry["margin"]) for metric, entry in found.items()}


def interval(mean: Any, std: Any, seeds: Any) -> tuple[Any, Any]:
    """Student's 90 % interval of a mean over seeds. std: the sample standard deviation. Arrays broadcast."""
    half = half_width(std, seeds, ALPHA)
    return mean - half, mean + half


def judge(low: Any, high: Any, published: float, half_unit: float, margin: float, higher: bool = True) -> Any:
    """The words for intervals low … high. half_unit: of the last printed digit. higher: whether higher is better."""
    inside = (low >= published + half_unit - margin) & (high <= published - half_unit + margin)
    above, below = low > published + half_unit + margin, high < published - half_unit - margin
    return np.select([inside, above, below], [REPRODUCED, *((BETTER, WORSE) if higher else (WORSE, BETTER))], UNDECIDED)


def seeds_needed(distance: float, std: float, half_unit: float, margin: float) -> str:
    """With how many seeds in all four of five repetitions would be decided, if distance and std are the true ones.

    distance: |our mean − published|. `n/a` where it is at the margin, to half a unit of print.
    """
    inner, outer = margin - half_unit, margin + half_unit
    if inner <= distance <= outer:
        return NEVER
    seeds = np.arange(2, MOST_SEEDS + 1)
    error = std / np.sqrt(seeds)
    if distance > outer:
        power = _power((distance - outer) / error, seeds)
    else:  # both one-sided tests have to reject; the sum of what each misses bounds what either misses
        power = _power((inner - distance) / error, seeds) + _power((inner + distance) / error, seeds) - 1
    enough = seeds[power >= POWER]
    return str(enough[0]) if len(enough) else f"> {MOST_SEEDS}"


def _power(shift: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """How often a one-sided t test rejects, at a true difference of `shift` standard errors (noncentral t)."""
    return stats.nct.sf(stats.t.isf(ALPHA, seeds - 1), seeds - 1, np.minimum(shift, 50.0))


def verdict(metric: str, scene: str, ours: float, published: float, std: float, seeds: int) -> Verdict:
    """The verdict on one published number. ours, std: mean and sample standard deviation over seeds (std NaN for one).

    An average over scenes is judged like a scene, by its own spread over the seeds that all of its scenes have.
    """
    nan = float("nan")
    margin = load_margins().get(metric, nan)
    if np.isnan(margin):
        why = "hours depend on the machine" if metric == "hours" else f"no margin is stated for {metric}"
        return Verdict(UNDECIDED, nan, nan, nan, NEVER, why)
    if np.isnan(ours):
        return Verdict(UNDECIDED, margin, nan, nan, UNKNOWN, "no number of ours")
    if seeds < 2 or np.isnan(std):
        return Verdict(UNDECIDED, margin, nan, nan, UNKNOWN, "one seed has no spread")
    half_unit = 0.5 * 10.0 ** -decimals(metric, scene)
    low, high = (float(end) for end in interval(ours, std, seeds))
    word = str(judge(low, high, published, half_unit, margin, HIGHER_IS_BETTER[metric]))
    if word != UNDECIDED:
        return Verdict(word, margin, low, high, "", "")
    needed = seeds_needed(abs(ours - published), std, half_unit, margin)
    why = "the difference is at the margin" if needed == NEVER else "the interval crosses the margin"
    return Verdict(word, margin, low, high, needed, why)


def in_words(judged: pd.DataFrame) -> str:
    """`2 reproduced, 3 undecided (4 to 9 seeds would decide 2; unknown for 1)`. judged: verdict, seeds_needed."""
    counts = judged["verdict"].value_counts()
    text = ", ".join(f"{counts[word]} {word}" for word in WORDS if word in counts)
    needed = judged.loc[judged["verdict"] == UNDECIDED, "seeds_needed"]
    numbers = needed[needed.str.isdigit()].astype(int)
    said = []
    if len(numbers):
        low, high = numbers.min(), numbers.max()
        said.append(f"{low if low == high else f'{low} to {high}'} seeds would decide {len(numbers)}")
    names = {f"> {MOST_SEEDS}": f"more than {MOST_SEEDS}", NEVER: "no number of seeds", UNKNOWN: "unknown"}
    said += [f"{name} for {(needed == key).sum()}" for key, name in names.items() if (needed == key).any()]
    return text + (f" ({'; '.join(said)})" if said else "")

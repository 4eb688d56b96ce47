"""Checks of claims on numbers of the main table (and the ablation's), as printed or ours.

A printed number is known to half a unit of its last digit, one of ours to its 95 % interval over seeds: a claim is
undecided where that interval holds both numbers that it fits and others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pandas as pd

from tdgbench.tables import measures, methods
from tdgbench.tables.between_papers import OFF, UNKNOWN, check_averages
from tdgbench.tables.claims.evidence import Claim, ClaimEvidence, Finding, MissingError
from tdgbench.tables.measures import AVERAGE, HOURS, MAIN_COLUMNS, OVERALL, digits
from tdgbench.tables.published import printed_half_unit
from tdgbench.tables.published_setup import departures
from tdgbench.tables.statistics import mean_interval
from tdgbench.tables.verdicts import load_margins


class MethodGain(NamedTuple):
    """A number of the paper's method (new) and of its baseline (old), at a scene or an average.

    low, high: of the gain, by how much the new value is better: the interval over seeds, or the gain of printed values.
    """

    scene: str
    metric: str
    new: float
    old: float
    low: float
    high: float

    @property
    def percent(self) -> float:
        """By how many percent the new value is better."""
        return float(100 * measures.gain(self.metric, self.new, self.old) / self.old)

    @property
    def change(self) -> str:
        """Both values in words, with the digits of print."""
        places = digits(self.metric, self.scene)
        return f"{self.old:.{places}f} → {self.new:.{places}f}"


def relative_gain(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the average of `metric` is `percent` better."""
    _need_the_published_setup(evidence, claim.metric)
    found, half = _overall(evidence, claim.metric)._replace(scene=OVERALL), printed_half_unit(claim.percent)
    low, high = (100 * end / found.old for end in (found.low, found.high))
    if evidence.printed:  # what the printed numbers allow
        tolerance = _tolerance(evidence, claim.metric, OVERALL)
        ends = [(found.new + a * tolerance, found.old + b * tolerance) for a in (-1, 1) for b in (-1, 1)]
        gains = [found._replace(new=new, old=old).percent for new, old in ends]
        low, high = min(gains), max(gains)
    surely, possibly = _fits(evidence, (low, high), float(claim.percent), half)
    grounds = f"{found.change} is {found.percent:+.3f} %"
    if not possibly and low / 100 - half <= float(claim.percent) <= high / 100 + half:
        grounds += f"; {claim.percent} is the fraction, not the percentage"
    return Finding.decided(surely, possibly, grounds)


def averages(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the averages of `metric` are `averages`, which are by method; ours, within the verdicts' margin."""
    _need_the_published_setup(evidence, claim.metric)
    values = {m: _by_seed(evidence, m, evidence.overall, claim.metric) for m in methods.paper_pair()}
    margin = 0.0 if evidence.printed else load_margins()[claim.metric]
    fits = [
        _fits(evidence, _interval(evidence, by_seed), float(printed), printed_half_unit(printed) + margin)
        for by_seed, printed in ((by_seed, claim.averages[m]) for m, by_seed in values.items())
    ]
    grounds = ", ".join(f"{methods.label(m)} {_value(evidence, m, evidence.overall, claim.metric):.4g}" for m in values)
    surely, possibly = map(all, zip(*fits, strict=True))
    return Finding.decided(surely, possibly, grounds)


def average_gains(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better in the average of each of `metrics`."""
    gains = [_overall(evidence, metric) for metric in claim.metrics]
    grounds = ", ".join(f"{_label(gain.metric)} {gain.percent:+.2f} %" for gain in gains)
    label = methods.label(methods.paper_pair().method)
    return _decided(min(gain.percent for gain in gains) > 0, f"{label} is better by {grounds}")


def minutes_saved(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that training takes `minutes` less on average, in print."""
    if not evidence.printed:
        raise MissingError("minutes depend on the machine")
    found, minutes = _overall(evidence, HOURS.name), float(claim.minutes)
    tolerance = 60 * 2 * _tolerance(evidence, HOURS.name, OVERALL) + printed_half_unit(claim.minutes)
    fits = _fits(evidence, (60 * found.low, 60 * found.high), minutes, tolerance)
    return Finding.decided(*fits, f"{60 * (found.old - found.new):.2f} min")


def better_scenes(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better at every scene of `dataset`, but for as many `exceptions` by metric."""
    gains, (new, old) = _gains(claim, evidence, claim.metrics), map(methods.label, methods.paper_pair())

    def values(gain: MethodGain) -> str:
        if evidence.printed:
            return f"{gain.scene} {gain.change}"
        before, after = (measures.as_text(gain.metric, value, gain.scene) for value in (gain.old, gain.new))
        return f"{gain.scene} ({old} {before}, {new} {after})"

    def exceptions(of: list[MethodGain]) -> dict[str, list[str]]:
        return {m: [values(gain) for gain in of if gain.metric == m] for m in claim.metrics}

    def few(of: dict[str, list[str]]) -> bool:
        return all(len(found) <= claim.exceptions.get(metric, 0) for metric, found in of.items())

    not_surely, worse = exceptions([g for g in gains if g.low <= 0]), exceptions([g for g in gains if g.high <= 0])
    parts = [f"{_label(metric)}: {', '.join(found)}" for metric, found in not_surely.items() if found]
    word = "not better" if evidence.printed else "not surely better"
    return Finding.decided(few(not_surely), few(worse), f"{word}: {'; '.join(parts)}" if parts else "better everywhere")


def better_mostly(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better in most scenes × metrics. Equal (printed) values are no gain."""
    gains = _gains(claim, evidence, claim.metrics)
    better, open_ = [gain.metric for gain in gains if gain.low > 0], _open(gains)
    by_metric = ", ".join(f"{_label(metric)} {better.count(metric)}" for metric in claim.metrics)
    word = "equal" if evidence.printed else "undecided"
    grounds = f"better by any amount in {len(better)} of {len(gains)} scenes × metrics, {word} in {open_} ({by_metric})"
    possibly = sum(gain.high > 0 for gain in gains) > len(gains) / 2
    return Finding.decided(len(better) > len(gains) / 2, possibly, grounds)


def mixed(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that each method is better somewhere among the data set's scenes × metrics."""
    gains = _gains(claim, evidence, claim.metrics)
    better, worse, open_ = sum(g.low > 0 for g in gains), sum(g.high < 0 for g in gains), _open(gains)
    label, word = methods.label(methods.paper_pair().method), "equal" if evidence.printed else "undecided"
    counts = f"{label} is better in {better}, worse in {worse}, {word} in {open_}"
    surely = better > 0 and worse > 0
    possibly = surely or (not evidence.printed and len(gains) > 1 and open_ + min(better, worse) > 0)
    return Finding.decided(surely, possibly, f"of {len(gains)} scenes × metrics {counts}")


def within(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that at every scene of `dataset` the two methods differ by at most `most`."""
    gains = _gains(claim, evidence, [claim.metric])
    widest = max(gains, key=lambda gain: abs(gain.new - gain.old))
    most = claim.most + 2 * _tolerance(evidence, claim.metric, widest.scene)
    over = [f"{gain.scene} {gain.new - gain.old:+.2f}" for gain in gains if abs(gain.new - gain.old) > most]
    fits = [_fits(evidence, (gain.low, gain.high), 0.0, most) for gain in gains]
    grounds = ", ".join(over) if over else f"at most {widest.new - widest.old:+.2f} at {widest.scene}"
    surely, possibly = map(all, zip(*fits, strict=True))
    return Finding.decided(surely, possibly, grounds)


def ablation_drop(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that every method of the ablation loses at least `drop` dB of PSNR from random points."""
    drops = {}
    for method in claim.methods:
        by_init = _by_init(evidence, method, "psnr")
        if not {"random", "colmap"} <= set(by_init.index):
            raise MissingError(f"no PSNR of {methods.label(method)} from random and from COLMAP points")
        drops[method] = float(by_init["colmap"] - by_init["random"])
    grounds = ", ".join(f"{methods.label(method)} loses {drop:.2f} dB" for method, drop in drops.items())
    return _decided(min(drops.values()) >= claim.drop, grounds)


def ablation_agrees(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the ablation's numbers from COLMAP points are the main table's averages over all scenes."""
    if not evidence.printed:
        raise MissingError("our tables are made of the same cells")
    off = []
    for metric in claim.metrics:
        for method in methods.paper_pair():
            there, here = _by_init(evidence, method, metric), _value(evidence, method, evidence.overall, metric)
            if abs(there["colmap"] - here) > 2 * _tolerance(evidence, metric, OVERALL):
                what = f"{methods.label(method)} {_label(metric)}"
                off.append(f"{what}: {there['colmap']} in the ablation, {here} in the main table")
    return _decided(not off, "; ".join(off) if off else "the same in both tables")


def averages_follow(_claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the averages are those of the rows."""
    table = evidence.main[evidence.main["metric"].isin(MAIN_COLUMNS)]
    places = zip(table["metric"], table["scene"], strict=True)
    checked = check_averages(table.assign(half_unit=[_tolerance(evidence, metric, scene) for metric, scene in places]))
    if checked.empty:
        raise MissingError("no averages")
    for row in checked[checked["verdict"] == UNKNOWN].itertuples():
        raise MissingError(f"{_label(row.metric)}, {row.scene} of {row.dataset or 'all'}, cannot be recomputed")
    off = [
        f"{methods.label(row.method)} {row.dataset} {_label(row.metric)}: {row.mean:.4f}, not {row.printed}"
        for row in checked[checked["verdict"] == OFF].itertuples()
    ]
    return _decided(not off, "; ".join(off) if off else f"all {len(checked)} follow, within rounding")


def bold_follows(_claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the better value of each row is bold. Values that print the same are a tie, which has no mark."""
    table = evidence.main[evidence.main["metric"].isin(MAIN_COLUMNS)]
    if table.empty:
        raise MissingError("no scene has both methods")
    if "bold" not in table:
        raise MissingError("our tables mark by another rule: all that seeds cannot tell from the best")
    goodness = [
        round(r.value, digits(r.metric, r.scene)) * (1 if measures.measure_of(r.metric).higher_is_better else -1)
        for r in table.itertuples()
    ]
    by_row = pd.Series(goodness, table.index).groupby([table["dataset"], table["scene"], table["metric"]])
    best = (by_row.rank(method="max", ascending=False) == 1) & (by_row.transform("count") > 1)
    places = list(
        dict.fromkeys(f"{row.scene} {_label(row.metric)}" for row in table[best != table["bold"]].itertuples())
    )
    return _decided(not places, ", ".join(places) if places else "every mark follows")


def _gains(claim: Claim, evidence: ClaimEvidence, metrics: list[str]) -> list[MethodGain]:
    """Return the numbers at each scene of `dataset`, in each of these metrics. Raises MissingError without a scene."""
    single = evidence.main[~evidence.main["scene"].isin((AVERAGE, OVERALL))]
    if claim.dataset is not None:
        single = single[single["dataset"] == claim.dataset]
    if single.empty:
        raise MissingError(f"no scene of {claim.dataset or 'any data set'}")
    return [_gain(evidence, scene, metric) for scene in single["scene"].unique() for metric in metrics]


def _overall(evidence: ClaimEvidence, metric: str) -> MethodGain:
    return _gain(evidence, evidence.overall, metric)


def _gain(evidence: ClaimEvidence, scene: str, metric: str) -> MethodGain:
    new, old = (_value(evidence, method, scene, metric) for method in methods.paper_pair())
    by_seed = [_by_seed(evidence, method, scene, metric) for method in methods.paper_pair()]
    low, high = _interval(evidence, measures.gain(metric, *by_seed))
    return MethodGain(scene, metric, new, old, low, high)


def _by_seed(evidence: ClaimEvidence, method: str, scene: str, metric: str) -> np.ndarray:
    """Return a number by seed (S,), NaN where a seed lacks it; of print, the number alone (1,)."""
    value = _value(evidence, method, scene, metric)
    if evidence.by_seed is None:
        return np.array([value])
    return evidence.by_seed.xs((method, scene, metric), level=("method", "scene", "metric")).to_numpy(float)[0]


def _interval(evidence: ClaimEvidence, by_seed: np.ndarray) -> tuple[float, float]:
    """Return the ends of the 95 % interval of a number by seed (S,), without any for one seed; of print, the number."""
    if evidence.by_seed is None:
        return by_seed[0], by_seed[0]
    known = by_seed[np.isfinite(by_seed)]
    return mean_interval(known)[1:] if len(known) > 1 else (-np.inf, np.inf)


def _fits(evidence: ClaimEvidence, ends: tuple[float, float], claimed: float, tolerance: float) -> tuple[bool, bool]:
    """Return whether a number between these ends is surely, and whether possibly, the claimed one to a tolerance.

    Printed numbers need only be possibly: their ends are rounding.
    """
    low, high = ends
    possibly = low <= claimed + tolerance and high >= claimed - tolerance
    return possibly if evidence.printed else claimed - tolerance <= low and high <= claimed + tolerance, possibly


def _open(gains: list[MethodGain]) -> int:
    """Return how many gains may be none."""
    return sum(gain.low <= 0 <= gain.high for gain in gains)


def _decided(holds: bool, grounds: str) -> Finding:
    return Finding.decided(holds, holds, grounds)


def _label(metric: str) -> str:
    return measures.measure_of(metric).label


def _value(evidence: ClaimEvidence, method: str, scene: str, metric: str) -> float:
    values = evidence.values.get((method, scene, metric), [])
    if len(values) != 1:
        keys = zip(evidence.main["method"], evidence.main["scene"], evidence.main["metric"], strict=True)
        rows = evidence.main[[key == (method, scene, metric) for key in keys]]
        reasons = [why for why in rows["reason"] if why] if "reason" in rows else []
        why = f": {reasons[0]}" if reasons else ""
        raise MissingError(f"no {_label(metric)} of {methods.label(method)} at {scene}{why}")
    return values[0]


def _by_init(evidence: ClaimEvidence, method: str, metric: str) -> pd.Series:
    """Return the ablation's values by init. Raises MissingError without an ablation."""
    if evidence.ablation is None:
        raise MissingError("no ablation over the initial points")
    table = evidence.ablation
    return table[(table["method"] == method) & (table["metric"] == metric)].set_index("init")["value"].dropna()


def _tolerance(evidence: ClaimEvidence, metric: str, scene: str) -> float:
    """Return how far a value may be from what was printed."""
    return measures.half_unit(metric, scene) if evidence.printed else 0.0


def _need_the_published_setup(evidence: ClaimEvidence, metric: str) -> None:
    """Raise MissingError unless the evidence is of the paper's scenes and setup, which the claimed number is for."""
    if not evidence.is_of_paper:
        raise MissingError("a number for the paper's scenes, which these are not")
    if unlike := departures([cell.record for cell in evidence.published_cells], metric):
        raise MissingError(f"a number for the published setup, which this is not: {unlike}")

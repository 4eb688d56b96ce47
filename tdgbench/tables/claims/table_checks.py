"""Checks of claims on numbers of the main table (and the ablation's), as printed or ours.

A printed number is known to half a unit of its last digit.
"""

from __future__ import annotations

from typing import NamedTuple

import pandas as pd

from tdgbench.tables import measures, methods
from tdgbench.tables.between_papers import OFF, UNKNOWN, check_averages
from tdgbench.tables.claims.evidence import Claim, ClaimEvidence, Finding, MissingError
from tdgbench.tables.measures import AVERAGE, HOURS, OVERALL, PUBLISHED, digits
from tdgbench.tables.published import printed_half_unit


class MethodGain(NamedTuple):
    """A number of the paper's method (new) and of its baseline (old), at a scene or an average."""

    scene: str
    metric: str
    new: float
    old: float

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
    _need_the_papers_scenes(evidence)
    found, half = _overall(evidence, claim.metric)._replace(scene=OVERALL), printed_half_unit(claim.percent)
    tolerance = _tolerance(evidence, claim.metric, OVERALL)
    ends = [(found.new + a * tolerance, found.old + b * tolerance) for a in (-1, 1) for b in (-1, 1)]
    gains = [found._replace(new=new, old=old).percent for new, old in ends]
    low, high = min(gains), max(gains)  # that the printed numbers allow
    fits = low <= float(claim.percent) + half and high >= float(claim.percent) - half
    grounds = f"{found.change} is {found.percent:+.3f} %"
    if not fits and low / 100 - half <= float(claim.percent) <= high / 100 + half:
        grounds += f"; {claim.percent} is the fraction, not the percentage"
    return Finding.decided(fits, grounds)


def averages(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the averages of `metric` are `averages`, which are by method."""
    _need_the_papers_scenes(evidence)
    found = _overall(evidence, claim.metric)
    values = dict(zip(methods.paper_pair(), (found.new, found.old), strict=True))
    printed = claim.averages
    fits = all(abs(v - float(printed[m])) <= printed_half_unit(printed[m]) for m, v in values.items())
    return Finding.decided(fits, ", ".join(f"{methods.label(method)} {value:.4g}" for method, value in values.items()))


def average_gains(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better in the average of each of `metrics`."""
    gains = [_overall(evidence, metric) for metric in claim.metrics]
    grounds = ", ".join(f"{gain.metric} {gain.percent:+.2f} %" for gain in gains)
    return Finding.decided(min(gain.percent for gain in gains) > 0, f"{_label()} is better by {grounds}")


def minutes_saved(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that training takes `minutes` less on average."""
    _need_the_papers_scenes(evidence)
    found = _overall(evidence, HOURS.name)
    tolerance = 60 * 2 * _tolerance(evidence, HOURS.name, OVERALL) + printed_half_unit(claim.minutes)
    saved = 60 * (found.old - found.new)
    return Finding.decided(abs(saved - float(claim.minutes)) <= tolerance, f"{saved:.2f} min")


def better_scenes(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better at every scene of `dataset`, but for as many `exceptions` by metric."""
    worse = [gain for gain in _gains(claim, evidence, claim.metrics) if gain.percent <= 0]
    texts = {m: [f"{gain.scene} {gain.change}" for gain in worse if gain.metric == m] for m in claim.metrics}
    fits = all(len(found) <= claim.exceptions.get(metric, 0) for metric, found in texts.items())
    parts = [f"{metric}: {', '.join(found)}" for metric, found in texts.items() if found]
    return Finding.decided(fits, "not better: " + "; ".join(parts) if parts else "better everywhere")


def better_mostly(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better in most scenes × metrics. Equal (printed) values are no gain."""
    gains = _gains(claim, evidence, claim.metrics)
    better, equal = [gain.metric for gain in gains if gain.percent > 0], sum(gain.percent == 0 for gain in gains)
    by_metric = ", ".join(f"{metric} {better.count(metric)}" for metric in claim.metrics)
    grounds = f"better in {len(better)} of {len(gains)} scenes × metrics, equal in {equal} ({by_metric})"
    return Finding.decided(len(better) > len(gains) / 2, grounds)


def mixed(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that each method is better somewhere among the data set's scenes × metrics."""
    gains = [gain.percent for gain in _gains(claim, evidence, claim.metrics)]
    better, worse = sum(gain > 0 for gain in gains), sum(gain < 0 for gain in gains)
    counts = f"better in {better}, worse in {worse}, equal in {len(gains) - better - worse}"
    return Finding.decided(better > 0 and worse > 0, f"of {len(gains)} scenes × metrics {_label()} is {counts}")


def within(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that at every scene of `dataset` the two methods differ by at most `most`."""
    gaps = {found.scene: found.new - found.old for found in _gains(claim, evidence, [claim.metric])}
    widest = max(gaps, key=lambda scene: abs(gaps[scene]))
    tolerance = 2 * _tolerance(evidence, claim.metric, widest)
    over = [f"{scene} {gap:+.2f}" for scene, gap in gaps.items() if abs(gap) > claim.most + tolerance]
    return Finding.decided(not over, ", ".join(over) if over else f"at most {gaps[widest]:+.2f} at {widest}")


def ablation_drop(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that every method of the ablation loses at least `drop` dB of PSNR from random points."""
    drops = {}
    for method in claim.methods:
        by_init = _by_init(evidence, method, "psnr")
        if not {"random", "colmap"} <= set(by_init.index):
            raise MissingError(f"no PSNR of {method} from random and from COLMAP points")
        drops[method] = float(by_init["colmap"] - by_init["random"])
    grounds = ", ".join(f"{method} loses {drop:.2f} dB" for method, drop in drops.items())
    return Finding.decided(min(drops.values()) >= claim.drop, grounds)


def ablation_agrees(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the ablation's numbers from COLMAP points are the main table's averages over all scenes."""
    if not evidence.printed:
        raise MissingError("our tables are made of the same cells")
    off = []
    for metric in claim.metrics:
        for method in methods.paper_pair():
            there, here = _by_init(evidence, method, metric), _value(evidence, method, evidence.overall, metric)
            if abs(there["colmap"] - here) > 2 * _tolerance(evidence, metric, OVERALL):
                off.append(f"{method} {metric}: {there['colmap']} in the ablation, {here} in the main table")
    return Finding.decided(not off, "; ".join(off) if off else "the same in both tables")


def averages_follow(_claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the averages are those of the rows."""
    table = evidence.main[evidence.main["metric"].isin(PUBLISHED)]
    places = zip(table["metric"], table["scene"], strict=True)
    checked = check_averages(table.assign(half_unit=[_tolerance(evidence, metric, scene) for metric, scene in places]))
    if checked.empty:
        raise MissingError("no averages")
    for row in checked[checked["verdict"] == UNKNOWN].itertuples():
        raise MissingError(f"{row.scene} of {row.dataset or 'all'} cannot be recomputed")
    off = [
        f"{row.method} {row.dataset} {row.metric}: {row.mean:.4f}, not {row.printed}"
        for row in checked[checked["verdict"] == OFF].itertuples()
    ]
    return Finding.decided(not off, "; ".join(off) if off else f"all {len(checked)} follow, within rounding")


def bold_follows(_claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the better value of each row is bold. Values that print the same are a tie, which has no mark."""
    table = evidence.main[evidence.main["metric"].isin(PUBLISHED)]
    if table.empty:
        raise MissingError("no scene has both methods")
    if "bold" not in table:
        raise MissingError("our tables mark by another rule: all that seeds cannot tell from the best")
    goodness = [
        round(r.value, digits(r.metric, r.scene)) * (1 if measures.MEASURES[r.metric].higher_is_better else -1)
        for r in table.itertuples()
    ]
    by_row = pd.Series(goodness, table.index).groupby([table["dataset"], table["scene"], table["metric"]])
    best = (by_row.rank(method="max", ascending=False) == 1) & (by_row.transform("count") > 1)
    places = list(dict.fromkeys(f"{row.scene} {row.metric}" for row in table[best != table["bold"]].itertuples()))
    return Finding.decided(not places, ", ".join(places) if places else "every mark follows")


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
    return MethodGain(scene, metric, *(_value(evidence, method, scene, metric) for method in methods.paper_pair()))


def _value(evidence: ClaimEvidence, method: str, scene: str, metric: str) -> float:
    table = evidence.main
    chosen = (table["method"] == method) & (table["scene"] == scene) & (table["metric"] == metric)
    values = table[chosen]["value"].dropna()
    if len(values) != 1:
        raise MissingError(f"no {metric} of {method} at {scene}")
    return float(values.iloc[0])


def _by_init(evidence: ClaimEvidence, method: str, metric: str) -> pd.Series:
    """Return the ablation's values by init. Raises MissingError without an ablation."""
    if evidence.ablation is None:
        raise MissingError("no ablation over the initial points")
    table = evidence.ablation
    return table[(table["method"] == method) & (table["metric"] == metric)].set_index("init")["value"].dropna()


def _tolerance(evidence: ClaimEvidence, metric: str, scene: str) -> float:
    """Return how far a value may be from what was printed."""
    return measures.half_unit(metric, scene) if evidence.printed else 0.0


def _label() -> str:
    return methods.label(methods.paper_pair().method)


def _need_the_papers_scenes(evidence: ClaimEvidence) -> None:
    """Raise MissingError unless the evidence is of the paper's scenes, which the claimed number is for."""
    if not evidence.is_of_paper:
        raise MissingError("a number for the paper's scenes, which these are not")

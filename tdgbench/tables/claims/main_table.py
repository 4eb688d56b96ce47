"""Checks of claims on numbers of the main table (and the ablation's), as printed or ours.

A printed number is known to half a unit of its last digit.
"""

from __future__ import annotations

import itertools

import pandas as pd

from tdgbench.tables import measures, methods
from tdgbench.tables.between_papers import OFF, UNKNOWN, check_averages
from tdgbench.tables.claims.evidence import FAILS, HOLDS, Claim, ClaimEvidence, Finding, MissingError
from tdgbench.tables.long_table import with_bold
from tdgbench.tables.measures import AVERAGE, HOURS, OVERALL, PUBLISHED, digits
from tdgbench.tables.published import printed_half_unit


def _value(evidence: ClaimEvidence, method: str, scene: str, metric: str) -> float:
    table = evidence.main
    chosen = (table["method"] == method) & (table["scene"] == scene) & (table["metric"] == metric)
    values = table[chosen]["value"].dropna()
    if len(values) != 1:
        raise MissingError(f"no {metric} of {method} at {scene}")
    return float(values.iloc[0])


def _pair(evidence: ClaimEvidence, scene: str, metric: str) -> tuple[float, float]:
    """Return the value of the paper's method, and its baseline's."""
    new, old = (_value(evidence, method, scene, metric) for method in methods.paper_pair())
    return new, old


def _label() -> str:
    return methods.label(methods.paper_pair().method)


def _tolerance(evidence: ClaimEvidence, metric: str, scene: str) -> float:
    """Return how far a value may be from what was printed."""
    return measures.half_unit(metric, scene) if evidence.printed else 0.0


def _gain(new: float, old: float, metric: str) -> float:
    """Return by how many percent the new value is better."""
    return 100 * measures.gain(metric, new, old) / old


def relative_gain(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the average of `metric` is `percent` better."""
    _of_paper(evidence)
    metric, percent = claim.metric, claim.percent
    new, old = _pair(evidence, evidence.overall, metric)
    tolerance, half = _tolerance(evidence, metric, OVERALL), printed_half_unit(percent)
    gains = [_gain(new + a * tolerance, old + b * tolerance, metric) for a in (-1, 1) for b in (-1, 1)]
    low, high = min(gains), max(gains)  # that the printed numbers allow
    fits = low <= float(percent) + half and high >= float(percent) - half
    places = digits(metric, OVERALL)
    grounds = f"{old:.{places}f} → {new:.{places}f} is {_gain(new, old, metric):+.3f} %"
    if not fits and low / 100 - half <= float(percent) <= high / 100 + half:
        grounds += f"; {percent} is the fraction, not the percentage"
    return Finding(HOLDS if fits else FAILS, grounds)


def averages(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the averages of `metric` are `averages`, which are by method."""
    _of_paper(evidence)
    values = dict(zip(methods.paper_pair(), _pair(evidence, evidence.overall, claim.metric), strict=True))
    printed = claim.averages
    fits = all(abs(v - float(printed[m])) <= printed_half_unit(printed[m]) for m, v in values.items())
    grounds = ", ".join(f"{methods.label(method)} {value:.4g}" for method, value in values.items())
    return Finding(HOLDS if fits else FAILS, grounds)


def average_gains(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better in the average of each of `metrics`."""
    gains = {metric: _gain(*_pair(evidence, evidence.overall, metric), metric) for metric in claim.metrics}
    grounds = ", ".join(f"{metric} {gain:+.2f} %" for metric, gain in gains.items())
    return Finding(FAILS if min(gains.values()) <= 0 else HOLDS, f"{_label()} is better by {grounds}")


def minutes_saved(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that training takes `minutes` less on average."""
    _of_paper(evidence)
    new, old = _pair(evidence, evidence.overall, HOURS.name)
    tolerance = 60 * 2 * _tolerance(evidence, HOURS.name, OVERALL) + printed_half_unit(claim.minutes)
    saved = 60 * (old - new)
    return Finding(HOLDS if abs(saved - float(claim.minutes)) <= tolerance else FAILS, f"{saved:.2f} min")


def _scenes(evidence: ClaimEvidence, dataset: str | None) -> list[str]:
    single = evidence.main[~evidence.main["scene"].isin((AVERAGE, OVERALL))]
    if dataset is not None:
        single = single[single["dataset"] == dataset]
    scenes = list(dict.fromkeys(single["scene"]))
    if not scenes:
        raise MissingError(f"no scene of {dataset or 'any data set'}")
    return scenes


def better_scenes(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better at every scene of `dataset`, but for as many `exceptions` by metric."""
    exceptions: dict[str, list[str]] = {metric: [] for metric in claim.metrics}
    for scene in _scenes(evidence, claim.dataset):
        for metric, texts in exceptions.items():
            new, old = _pair(evidence, scene, metric)
            if _gain(new, old, metric) <= 0:
                texts.append(f"{scene} {old:.{digits(metric)}f} → {new:.{digits(metric)}f}")
    fits = all(len(texts) <= claim.exceptions.get(metric, 0) for metric, texts in exceptions.items())
    parts = [f"{metric}: {', '.join(texts)}" for metric, texts in exceptions.items() if texts]
    return Finding(HOLDS if fits else FAILS, "not better: " + "; ".join(parts) if parts else "better everywhere")


def better_mostly(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the paper's method is better in most scenes × metrics. Equal (printed) values are no gain."""
    gains = _gains(claim, evidence)
    better, equal = [metric for metric, gain in gains if gain > 0], sum(gain == 0 for _, gain in gains)
    grounds = f"better in {len(better)} of {len(gains)} scenes × metrics, equal in {equal}"
    by_metric = ", ".join(f"{metric} {better.count(metric)}" for metric in claim.metrics)
    return Finding(HOLDS if len(better) > len(gains) / 2 else FAILS, f"{grounds} ({by_metric})")


def mixed(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that each method is better somewhere among the data set's scenes × metrics."""
    gains = [gain for _, gain in _gains(claim, evidence)]
    better, worse = sum(gain > 0 for gain in gains), sum(gain < 0 for gain in gains)
    counts = f"better in {better}, worse in {worse}, equal in {len(gains) - better - worse}"
    return Finding(HOLDS if better and worse else FAILS, f"of {len(gains)} scenes × metrics {_label()} is {counts}")


def within(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that at every scene of `dataset` the two methods differ by at most `most`."""
    gaps = {}
    for scene in _scenes(evidence, claim.dataset):
        new, old = _pair(evidence, scene, claim.metric)
        gaps[scene] = new - old
    widest = max(gaps, key=lambda scene: abs(gaps[scene]))
    tolerance = 2 * _tolerance(evidence, claim.metric, widest)
    over = [f"{scene} {gap:+.2f}" for scene, gap in gaps.items() if abs(gap) > claim.most + tolerance]
    grounds = ", ".join(over) if over else f"at most {gaps[widest]:+.2f} at {widest}"
    return Finding(FAILS if over else HOLDS, grounds)


def ablation_drop(claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that every method of the ablation loses at least `drop` dB of PSNR from random points."""
    drops = {}
    for method in claim.methods:
        by_init = _by_init(evidence, method, "psnr")
        if not {"random", "colmap"} <= set(by_init.index):
            raise MissingError(f"no PSNR of {method} from random and from COLMAP points")
        drops[method] = float(by_init["colmap"] - by_init["random"])
    grounds = ", ".join(f"{method} loses {drop:.2f} dB" for method, drop in drops.items())
    return Finding(HOLDS if min(drops.values()) >= claim.drop else FAILS, grounds)


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
    return Finding(FAILS if off else HOLDS, "; ".join(off) if off else "the same in both tables")


def averages_follow(_claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the averages are those of the rows."""
    table = evidence.main[evidence.main["metric"].isin(PUBLISHED)]
    rounding = [
        _tolerance(evidence, metric, scene) for metric, scene in zip(table["metric"], table["scene"], strict=True)
    ]
    checked = check_averages(table.assign(half_unit=rounding))
    if checked.empty:
        raise MissingError("no averages")
    for row in checked[checked["verdict"] == UNKNOWN].itertuples():
        raise MissingError(f"{row.scene} of {row.dataset or 'all'} cannot be recomputed")
    off = [
        f"{row.method} {row.dataset} {row.metric}: {row.mean:.4f}, not {row.printed}"
        for row in checked[checked["verdict"] == OFF].itertuples()
    ]
    return Finding(FAILS if off else HOLDS, "; ".join(off) if off else f"all {len(checked)} follow, within rounding")


def bold_follows(_claim: Claim, evidence: ClaimEvidence) -> Finding:
    """Check that the better value of each row is bold."""
    table = evidence.main.reset_index(drop=True)
    made = with_bold(table.drop(columns="bold"))
    marked = table["metric"].isin(PUBLISHED)
    if not marked.any():
        raise MissingError("no scene has both methods")
    odd = table[(made["bold"].to_numpy() != table["bold"].to_numpy()) & marked]
    places = list(dict.fromkeys(f"{row.scene} {row.metric}" for row in odd.itertuples()))
    return Finding(FAILS if places else HOLDS, ", ".join(places) if places else "every mark follows")


def _of_paper(evidence: ClaimEvidence) -> None:
    """Raise MissingError unless the evidence is of the paper's scenes, which the claimed number is for."""
    if not evidence.is_of_paper:
        raise MissingError("a number for the paper's scenes, which these are not")


def _gains(claim: Claim, evidence: ClaimEvidence) -> list[tuple[str, float]]:
    """Return metric and gain of the paper's method, percent, for each scene × metric of `dataset`."""
    places = itertools.product(_scenes(evidence, claim.dataset), claim.metrics)
    return [(metric, _gain(*_pair(evidence, scene, metric), metric)) for scene, metric in places]


def _by_init(evidence: ClaimEvidence, method: str, metric: str) -> pd.Series:
    """Return the ablation's values by init. Raises MissingError without an ablation."""
    if evidence.ablation is None:
        raise MissingError("no ablation over the initial points")
    table = evidence.ablation
    return table[(table["method"] == method) & (table["metric"] == metric)].set_index("init")["value"].dropna()

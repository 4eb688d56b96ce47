"""Checks on numbers of the main table (and the ablation's), as printed or of ours.

What is printed with so many digits is believed to half a unit of the last one.
"""

from __future__ import annotations

from typing import Any

import pandas as pd

from tdgbench.tables.averages import OFF, UNKNOWN, check_averages
from tdgbench.tables.claims.evidence import FAILS, HOLDS, METHODS, Evidence, Finding, MissingError
from tdgbench.tables.published import half_unit
from tdgbench.tables.results import (
    AVERAGE,
    DECIMALS,
    HIGHER_IS_BETTER,
    METRICS,
    OVERALL,
    decimals,
    with_bold,
)


def _value(evidence: Evidence, method: str, scene: str, metric: str) -> float:
    table = evidence.main
    own = table[(table["method"] == method) & (table["scene"] == scene) & (table["metric"] == metric)]["value"].dropna()
    if len(own) != 1:
        raise MissingError(f"no {metric} of {method} at {scene}")
    return float(own.iloc[0])


def _pair(evidence: Evidence, scene: str, metric: str) -> tuple[float, float]:
    """TDg's and MSMG's value."""
    tdg, msmg = (_value(evidence, method, scene, metric) for method in METHODS)
    return tdg, msmg


def _tolerance(evidence: Evidence, metric: str, scene: str) -> float:
    """How far a value may be from what was printed."""
    return 0.5 * 10.0 ** -decimals(metric, scene) if evidence.printed else 0.0


def _gain(tdg: float, msmg: float, metric: str) -> float:
    """By how many percent TDg is better."""
    sign = 1 if HIGHER_IS_BETTER[metric] else -1
    return sign * 100 * (tdg - msmg) / msmg


def _gain_range(evidence: Evidence, metric: str, tdg: float, msmg: float) -> tuple[float, float]:
    """All gains that the printed numbers leave possible."""
    tolerance = _tolerance(evidence, metric, OVERALL)
    gains = [_gain(tdg + a * tolerance, msmg + b * tolerance, metric) for a in (-1, 1) for b in (-1, 1)]
    return min(gains), max(gains)


def relative_gain(claim: dict[str, Any], evidence: Evidence) -> Finding:
    metric, percent = claim["metric"], claim["percent"]
    tdg, msmg = _pair(evidence, evidence.overall, metric)
    low, high = _gain_range(evidence, metric, tdg, msmg)
    half = half_unit(percent)
    fits = low <= float(percent) + half and high >= float(percent) - half
    digits = decimals(metric, OVERALL)
    seen = f"{msmg:.{digits}f} → {tdg:.{digits}f} is {_gain(tdg, msmg, metric):+.3f} %"
    if not fits and low / 100 - half <= float(percent) <= high / 100 + half:
        seen += f"; {percent} is the fraction, not the percentage"
    return Finding(HOLDS if fits else FAILS, seen)


def averages(claim: dict[str, Any], evidence: Evidence) -> Finding:
    _of_paper(evidence)
    metric = claim["metric"]
    tdg, msmg = _pair(evidence, evidence.overall, metric)
    fits = all(abs(v - float(claim[m])) <= half_unit(claim[m]) for m, v in (("tdg", tdg), ("msmg", msmg)))
    return Finding(HOLDS if fits else FAILS, f"TDg {tdg:.4g}, MSMG {msmg:.4g}")


def better_average(claim: dict[str, Any], evidence: Evidence) -> Finding:
    worse, seen = [], []
    for metric in claim["metrics"]:
        tdg, msmg = _pair(evidence, evidence.overall, metric)
        gain = _gain(tdg, msmg, metric)
        seen.append(f"{metric} {gain:+.2f} %")
        if gain <= 0:
            worse.append(metric)
    return Finding(FAILS if worse else HOLDS, "TDg is better by " + ", ".join(seen))


def minutes_saved(claim: dict[str, Any], evidence: Evidence) -> Finding:
    _of_paper(evidence)
    tdg, msmg = _pair(evidence, evidence.overall, "hours")
    tolerance = 60 * 2 * _tolerance(evidence, "hours", OVERALL) + half_unit(claim["minutes"])
    saved = 60 * (msmg - tdg)
    return Finding(HOLDS if abs(saved - float(claim["minutes"])) <= tolerance else FAILS, f"{saved:.2f} min")


def percent_saved(claim: dict[str, Any], evidence: Evidence) -> Finding:
    tdg, msmg = _pair(evidence, evidence.overall, "hours")
    low, high = _gain_range(evidence, "hours", tdg, msmg)
    half = half_unit(claim["percent"])
    fits = low <= float(claim["percent"]) + half and high >= float(claim["percent"]) - half
    return Finding(HOLDS if fits else FAILS, f"{_gain(tdg, msmg, 'hours'):.1f} %")


def _scenes(evidence: Evidence, dataset: str | None) -> list[str]:
    single = evidence.main[~evidence.main["scene"].isin((AVERAGE, OVERALL))]
    if dataset is not None:
        single = single[single["dataset"] == dataset]
    scenes = list(dict.fromkeys(single["scene"]))
    if not scenes:
        raise MissingError(f"no scene of {dataset or 'any data set'}")
    return scenes


def better_scenes(claim: dict[str, Any], evidence: Evidence) -> Finding:
    counted: dict[str, list[str]] = {metric: [] for metric in claim["metrics"]}
    for scene in _scenes(evidence, claim["dataset"]):
        for metric in claim["metrics"]:
            tdg, msmg = _pair(evidence, scene, metric)
            if _gain(tdg, msmg, metric) <= 0:
                counted[metric].append(f"{scene} {msmg:.{DECIMALS[metric]}f} → {tdg:.{DECIMALS[metric]}f}")
    fits = all(len(found) <= claim["exceptions"].get(metric, 0) for metric, found in counted.items())
    said = [f"{metric}: {', '.join(found)}" for metric, found in counted.items() if found]
    return Finding(HOLDS if fits else FAILS, "not better: " + "; ".join(said) if said else "better everywhere")


def better_mostly(claim: dict[str, Any], evidence: Evidence) -> Finding:
    """TDg is better in more than half of all scenes × metrics; equal values (as printed, if printed) are no gain."""
    better, equal, total = _wins(claim, evidence)
    seen = f"better in {len(better)} of {total} scenes × metrics, equal in {len(equal)}"
    by_metric = ", ".join(f"{metric} {sum(m == metric for _, m in better)}" for metric in claim["metrics"])
    return Finding(HOLDS if len(better) > total / 2 else FAILS, f"{seen} ({by_metric})")


def mixed(claim: dict[str, Any], evidence: Evidence) -> Finding:
    """Each method is better somewhere among the data set's scenes × metrics."""
    better, equal, total = _wins(claim, evidence)
    worse = total - len(better) - len(equal)
    seen = f"of {total} scenes × metrics TDg is better in {len(better)}, worse in {worse}, equal in {len(equal)}"
    return Finding(HOLDS if better and worse else FAILS, seen)


def within(claim: dict[str, Any], evidence: Evidence) -> Finding:
    gaps = {}
    for scene in _scenes(evidence, claim["dataset"]):
        tdg, msmg = _pair(evidence, scene, claim["metric"])
        gaps[scene] = tdg - msmg
    widest = max(gaps, key=lambda scene: abs(gaps[scene]))
    tolerance = 2 * _tolerance(evidence, claim["metric"], widest)
    over = [f"{scene} {gap:+.2f}" for scene, gap in gaps.items() if abs(gap) > claim["most"] + tolerance]
    seen = ", ".join(over) if over else f"at most {gaps[widest]:+.2f} at {widest}"
    return Finding(FAILS if over else HOLDS, seen)


def ablation_drop(claim: dict[str, Any], evidence: Evidence) -> Finding:
    """Every method of the ablation loses at least `drop` dB of PSNR from random points."""
    drops = {}
    for method in claim["methods"]:
        by_init = _by_init(evidence, method, "psnr")
        if not {"random", "colmap"} <= set(by_init.index):
            raise MissingError(f"no PSNR of {method} from random and from COLMAP points")
        drops[method] = float(by_init["colmap"] - by_init["random"])
    seen = ", ".join(f"{method} loses {drop:.2f} dB" for method, drop in drops.items())
    return Finding(HOLDS if min(drops.values()) >= claim["drop"] else FAILS, seen)


def ablation_agrees(claim: dict[str, Any], evidence: Evidence) -> Finding:
    """The ablation's numbers from COLMAP points are the main table's averages over all scenes."""
    if not evidence.printed:
        raise MissingError("our tables are made of the same cells")
    off = []
    for metric in claim["metrics"]:
        for method in METHODS:
            there, here = _by_init(evidence, method, metric), _value(evidence, method, evidence.overall, metric)
            if abs(there["colmap"] - here) > 2 * _tolerance(evidence, metric, OVERALL):
                off.append(f"{method} {metric}: {there['colmap']} in the ablation, {here} in the main table")
    return Finding(FAILS if off else HOLDS, "; ".join(off) if off else "the same in both tables")


def averages_follow(_claim: dict[str, Any], evidence: Evidence) -> Finding:
    table = evidence.main[evidence.main["metric"].isin(METRICS)]
    rounding = [
        _tolerance(evidence, metric, scene) for metric, scene in zip(table["metric"], table["scene"], strict=True)
    ]
    found = check_averages(table.assign(half_unit=rounding))
    if found.empty:
        raise MissingError("no averages")
    for row in found[found["verdict"] == UNKNOWN].itertuples():
        raise MissingError(f"{row.scene} of {row.dataset or 'all'} cannot be recomputed")
    off = [
        f"{row.method} {row.dataset} {row.metric}: {row.mean:.4f}, not {row.printed}"
        for row in found[found["verdict"] == OFF].itertuples()
    ]
    return Finding(FAILS if off else HOLDS, "; ".join(off) if off else f"all {len(found)} follow, within rounding")


def bold_follows(_claim: dict[str, Any], evidence: Evidence) -> Finding:
    table = evidence.main.reset_index(drop=True)
    made = with_bold(table.drop(columns="bold"))
    marked = table["metric"].isin(METRICS)
    odd = table[(made["bold"].to_numpy() != table["bold"].to_numpy()) & marked]
    places = list(dict.fromkeys(f"{row.scene} {row.metric}" for row in odd.itertuples()))
    return Finding(FAILS if places else HOLDS, ", ".join(places) if places else "every mark follows")


def _of_paper(evidence: Evidence) -> None:
    """Raise MissingError where numbers of other scenes would be held against a number for the paper's."""
    if not evidence.is_of_paper:
        raise MissingError("a number for the paper's scenes, which these are not")


def _wins(claim: dict[str, Any], evidence: Evidence) -> tuple[list[tuple[str, str]], list[tuple[str, str]], int]:
    """Scene and metric where TDg is better, and where both are equal; and how many there are."""
    better, equal, total = [], [], 0
    for scene in _scenes(evidence, claim["dataset"]):
        for metric in claim["metrics"]:
            gain = _gain(*_pair(evidence, scene, metric), metric)
            total += 1
            if gain > 0:
                better.append((scene, metric))
            elif gain == 0:
                equal.append((scene, metric))
    return better, equal, total


def _by_init(evidence: Evidence, method: str, metric: str) -> pd.Series:
    """The ablation's values by init; raises MissingError where there is none."""
    if evidence.ablation is None:
        raise MissingError("no ablation over the first points")
    table = evidence.ablation
    return table[(table["method"] == method) & (table["metric"] == metric)].set_index("init")["value"].dropna()

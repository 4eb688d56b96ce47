"""The paper's claims in words, each held against a table: the published one, or ours.

A claim `holds`, `fails`, or is `undecided` where the table lacks what it is about. What is printed with so many digits
is believed to half a unit of the last one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

from tdgbench.tables.averages import OFF, UNKNOWN, check_averages
from tdgbench.tables.between_papers import gain_against_spread
from tdgbench.tables.published import FOLDER, half_unit
from tdgbench.tables.results import (
    AVERAGE,
    DECIMALS,
    HIGHER_IS_BETTER,
    METRICS,
    OVERALL,
    decimals,
    with_bold,
)

HOLDS, FAILS, UNDECIDED = "holds", "fails", "undecided"
METHODS = ("tdg", "msmg")


@dataclass(frozen=True)
class Evidence:
    """A main table (method, dataset, group, scene, metric, value, bold) and an ablation (method, init, metric, value).

    printed: whether the values were rounded for print, so that each is known to half a unit only.
    """

    main: pd.DataFrame
    ablation: pd.DataFrame | None
    printed: bool


@dataclass(frozen=True)
class Finding:
    """What became of a claim, and what was seen."""

    verdict: str
    seen: str


class MissingError(Exception):
    """The table has no number that a claim is about."""


def load_claims(path: Path = FOLDER / "claims.yaml") -> list[dict[str, Any]]:
    """The claims. Raises ValueError for one without id, words or a known check."""
    claims: list[dict[str, Any]] = OmegaConf.to_container(OmegaConf.load(path))  # type: ignore[assignment]
    for claim in claims:
        lacking = {"id", "said", "where", "check"} - set(claim)
        if lacking:
            raise ValueError(f"{path}: claim {claim.get('id', '?')} lacks {', '.join(sorted(lacking))}")
        if claim["check"] not in CHECKS:
            raise ValueError(f"{path}: claim {claim['id']} has an unknown check {claim['check']!r}")
    return claims


def check_claim(claim: dict[str, Any], evidence: Evidence) -> Finding:
    """Hold one claim against a table. A claim with `gain` says where it claims one, which is held against the spread
    between papers."""
    try:
        found = CHECKS[claim["check"]](claim, evidence)
    except MissingError as error:
        return Finding(UNDECIDED, str(error))
    if "gain" not in claim:
        return found
    metrics = claim["metrics"] if "metrics" in claim else [claim["metric"]]
    against = gain_against_spread(evidence.main, metrics, claim["gain"])
    return Finding(found.verdict, "; ".join(part for part in (found.seen, against) if part))


def check_all(claims: list[dict[str, Any]], published: Evidence, ours: Evidence | None) -> pd.DataFrame:
    """One row per claim: id, said, where, and verdict and sight of the published table and of ours."""
    rows = []
    for claim in claims:
        row = {"id": claim["id"], "said": claim["said"], "where": claim["where"]}
        for side, evidence in (("published", published), ("ours", ours)):
            found = Finding(UNDECIDED, "no results") if evidence is None else check_claim(claim, evidence)
            row |= {side: found.verdict, f"{side}_seen": found.seen}
        rows.append(row)
    return pd.DataFrame(rows)


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


def _room(evidence: Evidence, metric: str, scene: str) -> float:
    """How far a value may be from what was printed."""
    return 0.5 * 10.0 ** -decimals(metric, scene) if evidence.printed else 0.0


def _gain(tdg: float, msmg: float, metric: str) -> float:
    """By how many percent TDg is better."""
    sign = 1 if HIGHER_IS_BETTER[metric] else -1
    return sign * 100 * (tdg - msmg) / msmg


def _gain_range(evidence: Evidence, metric: str, tdg: float, msmg: float) -> tuple[float, float]:
    """All gains that the printed numbers leave possible."""
    room = _room(evidence, metric, OVERALL)
    gains = [_gain(tdg + a * room, msmg + b * room, metric) for a in (-1, 1) for b in (-1, 1)]
    return min(gains), max(gains)


def _relative_gain(claim: dict[str, Any], evidence: Evidence) -> Finding:
    metric, percent = claim["metric"], claim["percent"]
    tdg, msmg = _pair(evidence, OVERALL, metric)
    low, high = _gain_range(evidence, metric, tdg, msmg)
    half = half_unit(percent)
    fits = low <= float(percent) + half and high >= float(percent) - half
    digits = decimals(metric, OVERALL)
    seen = f"{msmg:.{digits}f} → {tdg:.{digits}f} is {_gain(tdg, msmg, metric):+.3f} %"
    if not fits and low / 100 - half <= float(percent) <= high / 100 + half:
        seen += f"; {percent} is the fraction, not the percentage"
    return Finding(HOLDS if fits else FAILS, seen)


def _averages(claim: dict[str, Any], evidence: Evidence) -> Finding:
    metric = claim["metric"]
    tdg, msmg = _pair(evidence, OVERALL, metric)
    fits = all(abs(v - float(claim[m])) <= half_unit(claim[m]) for m, v in (("tdg", tdg), ("msmg", msmg)))
    return Finding(HOLDS if fits else FAILS, f"TDg {tdg:.4g}, MSMG {msmg:.4g}")


def _better_average(claim: dict[str, Any], evidence: Evidence) -> Finding:
    worse, seen = [], []
    for metric in claim["metrics"]:
        tdg, msmg = _pair(evidence, OVERALL, metric)
        gain = _gain(tdg, msmg, metric)
        seen.append(f"{metric} {gain:+.2f} %")
        if gain <= 0:
            worse.append(metric)
    return Finding(FAILS if worse else HOLDS, "TDg is better by " + ", ".join(seen))


def _minutes_saved(claim: dict[str, Any], evidence: Evidence) -> Finding:
    tdg, msmg = _pair(evidence, OVERALL, "hours")
    room = 60 * 2 * _room(evidence, "hours", OVERALL) + half_unit(claim["minutes"])
    saved = 60 * (msmg - tdg)
    return Finding(HOLDS if abs(saved - float(claim["minutes"])) <= room else FAILS, f"{saved:.2f} min")


def _percent_saved(claim: dict[str, Any], evidence: Evidence) -> Finding:
    tdg, msmg = _pair(evidence, OVERALL, "hours")
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


def _better_scenes(claim: dict[str, Any], evidence: Evidence) -> Finding:
    counted: dict[str, list[str]] = {metric: [] for metric in claim["metrics"]}
    for scene in _scenes(evidence, claim["dataset"]):
        for metric in claim["metrics"]:
            tdg, msmg = _pair(evidence, scene, metric)
            if _gain(tdg, msmg, metric) <= 0:
                counted[metric].append(f"{scene} {msmg:.{DECIMALS[metric]}f} → {tdg:.{DECIMALS[metric]}f}")
    fits = all(len(found) <= claim["exceptions"].get(metric, 0) for metric, found in counted.items())
    said = [f"{metric}: {', '.join(found)}" for metric, found in counted.items() if found]
    return Finding(HOLDS if fits else FAILS, "not better: " + "; ".join(said) if said else "better everywhere")


def _within(claim: dict[str, Any], evidence: Evidence) -> Finding:
    gaps = {}
    for scene in _scenes(evidence, claim["dataset"]):
        tdg, msmg = _pair(evidence, scene, claim["metric"])
        gaps[scene] = tdg - msmg
    widest = max(gaps, key=lambda scene: abs(gaps[scene]))
    room = 2 * _room(evidence, claim["metric"], widest)
    over = [f"{scene} {gap:+.2f}" for scene, gap in gaps.items() if abs(gap) > claim["most"] + room]
    seen = ", ".join(over) if over else f"at most {gaps[widest]:+.2f} at {widest}"
    return Finding(FAILS if over else HOLDS, seen)


def _random_fails(claim: dict[str, Any], evidence: Evidence) -> Finding:
    if evidence.ablation is None:
        raise MissingError("no ablation over the first points")
    drops = {}
    for method in METHODS:
        own = evidence.ablation[(evidence.ablation["method"] == method) & (evidence.ablation["metric"] == "psnr")]
        by_init = own.set_index("init")["value"]
        if not {"random", "colmap"} <= set(by_init.dropna().index):
            raise MissingError(f"no PSNR of {method} from random and from COLMAP points")
        drops[method] = float(by_init["colmap"] - by_init["random"])
    seen = ", ".join(f"{method} loses {drop:.2f} dB" for method, drop in drops.items())
    return Finding(HOLDS if min(drops.values()) >= claim["drop"] else FAILS, seen)


def _averages_follow(_claim: dict[str, Any], evidence: Evidence) -> Finding:
    table = evidence.main
    rounding = [_room(evidence, metric, scene) for metric, scene in zip(table["metric"], table["scene"], strict=True)]
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


def _bold_follows(_claim: dict[str, Any], evidence: Evidence) -> Finding:
    table = evidence.main.reset_index(drop=True)
    made = with_bold(table.drop(columns="bold"))
    marked = table["metric"].isin(METRICS)
    odd = table[(made["bold"].to_numpy() != table["bold"].to_numpy()) & marked]
    places = list(dict.fromkeys(f"{row.scene} {row.metric}" for row in odd.itertuples()))
    return Finding(FAILS if places else HOLDS, ", ".join(places) if places else "every mark follows")


CHECKS: dict[str, Callable[[dict[str, Any], Evidence], Finding]] = {
    "relative_gain": _relative_gain,
    "averages": _averages,
    "better_average": _better_average,
    "minutes_saved": _minutes_saved,
    "percent_saved": _percent_saved,
    "better_scenes": _better_scenes,
    "within": _within,
    "random_fails": _random_fails,
    "averages_follow": _averages_follow,
    "bold_follows": _bold_follows,
}

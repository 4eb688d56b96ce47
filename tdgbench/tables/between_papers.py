"""How far papers are apart that print numbers for the same method and scene, and whether a gain is larger than that.

Papers differ in splits, training lengths, seeds and code, so their spread is what a gain inside one paper has to exceed
before it can be told from the choice of setup. Averages are compared over the scenes that the papers share, never as
printed: papers average over different scenes.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd

from tdgbench.tables.averages import check_averages
from tdgbench.tables.published import PAPER, load_sources, published_elsewhere, published_main
from tdgbench.tables.results import AVERAGE, DECIMALS, HIGHER_IS_BETTER, OVERALL, decimals

PLACE = ["method", "dataset", "scene", "metric"]
SHARED = "Average (shared scenes)"
GAINER, BASELINE = "tdg", "msmg"
UNITS = {"psnr": " dB"}


@cache
def between_papers() -> pd.DataFrame:
    """One row per method, dataset, scene and metric that two papers or more print.

    Columns: PLACE, papers (how many), low, high, spread (high − low), scenes (1, or of the average), values (in words),
    note (where a source leaves open which method it means). The scene SHARED is the average over the scenes that all
    papers on the method have.
    """
    numbers = _numbers()
    rows = [_row(place, group) for place, group in numbers.groupby(PLACE, sort=False) if group["source"].nunique() > 1]
    for (method, dataset, metric), group in numbers.groupby(["method", "dataset", "metric"], sort=False):
        wide = group.pivot(index="scene", columns="source", values="value").dropna()
        if wide.shape[1] > 1 and len(wide) > 1:
            means = wide.mean().rename("value").reset_index()
            means["printed_as"] = means["source"].map(group.groupby("source")["printed_as"].first())
            rows.append(_row((method, dataset, SHARED, metric), means, len(wide)))
    return pd.DataFrame(rows)


def with_others(differences: pd.DataFrame) -> pd.DataFrame:
    """The table with others_low, others_high (NaN where no other paper has the number), and papers (with this one)."""
    others = _numbers().query("source != @PAPER").groupby(PLACE)["value"]
    ranges = others.agg(others_low="min", others_high="max", papers="count").reset_index()
    if "scene" not in differences:  # the ablation: averages, which other papers take over other scenes
        return differences.assign(others_low=np.nan, others_high=np.nan, papers=1)
    merged = differences.merge(ranges, on=PLACE, how="left")
    merged["papers"] = merged["papers"].fillna(0).astype(int) + 1
    return merged


def gain_against_spread(main: pd.DataFrame, metrics: list[str], over: str) -> str:
    """Whether TDg's gains over MSMG are larger than the spread between papers for MSMG, in words; empty if unknown.

    main: a main table. over: `overall` (the average gain) or `scenes` (every scene's). Empty where the table has no
    gain, or lacks the scenes that papers share.
    """
    if over not in ("overall", "scenes"):
        raise ValueError(f"a claim's gain is over {over!r}; it must be overall or scenes")
    spreads = between_papers()
    said = []
    for metric in metrics:
        group = spreads[(spreads["method"] == BASELINE) & (spreads["metric"] == metric)]
        if group.empty:  # hours, for one: only one paper prints them
            continue
        gains, places = _gains(main, metric), group[group["scene"] != SHARED]
        if not set(places["scene"]) <= set(gains.index):
            continue
        if over == "overall":
            said.append(_overall(gains, group, metric))
        else:
            said.append(_by_scene(gains, places, metric))
    return "; ".join(text for text in said if text)


def all_averages() -> pd.DataFrame:
    """The averages of every source, checked: source, and what `check_averages` finds."""
    ours = published_main()
    places = zip(ours["metric"], ours["scene"], strict=True)
    ours["half_unit"] = [0.5 * 10.0 ** -decimals(metric, scene) for metric, scene in places]
    parts = [check_averages(ours).assign(source=PAPER)]
    for source, table in published_elsewhere().groupby("source", sort=False):
        parts.append(check_averages(table.assign(method=table["printed_as"])).assign(source=source))
    found = pd.concat(parts, ignore_index=True)
    return found[["source", "method", "dataset", "scene", "metric", "printed", "mean", "tolerance", "verdict"]]


def _numbers() -> pd.DataFrame:
    """source, PLACE, value, printed_as of all papers: scenes alone, scores alone."""
    ours = published_main().assign(source=PAPER)
    table = pd.concat([ours.assign(printed_as=ours["method"]), published_elsewhere()], ignore_index=True)
    kept = ~table["scene"].isin((AVERAGE, OVERALL)) & (table["metric"] != "hours")
    return table.loc[kept, ["source", *PLACE, "value", "printed_as"]]


def _row(place: tuple[str, ...], group: pd.DataFrame, scenes: int = 1) -> dict[str, object]:
    sources, digits = load_sources(), DECIMALS[place[3]]
    notes = []
    for row in group.itertuples():
        entry = sources[row.source].methods.get(row.printed_as, {})
        if entry and not entry["sure"]:
            notes.append(f"{row.source}, {row.printed_as}: {entry['note']}")
    low, high = float(group["value"].min()), float(group["value"].max())
    values = "; ".join(f"{row.source} {row.value:.{digits}f}" for row in group.itertuples())
    return {
        **dict(zip(PLACE, place, strict=True)),
        "papers": len(group), "low": low, "high": high, "spread": round(high - low, 9), "scenes": scenes,
        "values": values, "note": "; ".join(notes),
    }  # fmt: skip


def _gains(main: pd.DataFrame, metric: str) -> pd.Series:
    """By how much TDg is better than MSMG, by scene; scenes without both are left out."""
    chosen = main[(main["metric"] == metric) & main["method"].isin((GAINER, BASELINE))]
    wide = chosen.pivot_table(index="scene", columns="method", values="value", aggfunc="first")
    if not {GAINER, BASELINE} <= set(wide):
        return pd.Series(dtype=float)
    return ((wide[GAINER] - wide[BASELINE]) * (1 if HIGHER_IS_BETTER[metric] else -1)).dropna()


def _overall(gains: pd.Series, group: pd.DataFrame, metric: str) -> str:
    """The average gain, and the gain over the scenes that papers share, which alone compares with the spread there."""
    if not gains.get(OVERALL, np.nan) > 0:
        return ""
    shared = group[group["scene"] == SHARED].iloc[0]
    gain = gains.reindex(group.loc[group["scene"] != SHARED, "scene"]).mean()
    digits, unit = decimals(metric, OVERALL), UNITS.get(metric, "")
    total, there, spread = (f"{value:.{digits}f}{unit}" for value in (gains[OVERALL], gain, shared.spread))
    return (
        f"the gain in {metric} is {total}; over the {shared.scenes} scenes that papers share it is {there}, "
        f"{_compared(gain, shared.spread)} the {spread} between papers"
    )


def _by_scene(gains: pd.Series, places: pd.DataFrame, metric: str) -> str:
    spread = places.set_index("scene")["spread"]
    gain = gains.reindex(spread.index)
    widest, digits, unit = spread.idxmax(), DECIMALS[metric], UNITS.get(metric, "")
    return (
        f"{metric}: {int((gain > spread).sum())} of {len(spread)} gains are larger than the spread between papers "
        f"({widest}: gain {gain[widest]:+.{digits}f}{unit}, spread {spread[widest]:.{digits}f}{unit})"
    )


def _compared(gain: float, spread: float) -> str:
    if np.isclose(gain, spread):
        return "equal to"
    return "larger than" if gain > spread else "smaller than"

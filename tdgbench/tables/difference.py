"""Ours − published, cell by cell."""

from __future__ import annotations

import pandas as pd


def difference(ours: pd.DataFrame, published: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """One row per published number: keys, ours, published, difference (NaN where ours is n/a), reason.

    >>> ours, paper = (pd.DataFrame({"method": ["tdg"], "value": [value]}) for value in (26.5, 26.25))
    >>> difference(ours, paper, ["method"])[["ours", "published", "difference"]].values.tolist()
    [[26.5, 26.25, 0.25]]
    """
    mine = ours[[*keys, "value", *(["reason"] if "reason" in ours else [])]].rename(columns={"value": "ours"})
    merged = published[[*keys, "value"]].rename(columns={"value": "published"}).merge(mine, on=keys, how="left")
    merged["difference"] = merged["ours"] - merged["published"]
    if "reason" not in merged:
        merged["reason"] = ""
    merged["reason"] = merged["reason"].fillna("no such cell in our results")
    return merged[[*keys, "ours", "published", "difference", "reason"]]

"""Check that printed averages follow from the rows above them, in papers and in our tables."""

from __future__ import annotations

import pandas as pd

from tdgbench.tables.names import AVERAGE, KEYS, OVERALL
from tdgbench.tables.results import with_averages

FOLLOWS, OFF, UNKNOWN = "follows", "does not follow", "cannot be recomputed"


def check_averages(table: pd.DataFrame) -> pd.DataFrame:
    """One row per average: KEYS, printed, mean (of its rows), tolerance, verdict.

    table: KEYS, value and half_unit (half a unit of the last printed digit; 0 for numbers that were not rounded).
    tolerance: the largest difference between the printed average and the mean of the printed rows due to rounding.
    """
    is_average = table["scene"].isin((AVERAGE, OVERALL))
    scenes = table[~is_average].assign(reason="")
    parts = []
    for name, column in (("mean", "value"), ("of_rows", "half_unit")):
        made = with_averages(scenes.assign(value=scenes[column]))
        parts.append(made.rename(columns={"value": name})[[*KEYS, name]])
    found = table[is_average].rename(columns={"value": "printed"})
    for part in parts:
        found = found.merge(part, on=KEYS, how="left")
    found["tolerance"] = found["half_unit"] + found["of_rows"]
    off = (found["mean"] - found["printed"]).abs() > found["tolerance"] + 1e-12
    found["verdict"] = off.map({True: OFF, False: FOLLOWS})
    found.loc[found["mean"].isna() | found["printed"].isna(), "verdict"] = UNKNOWN
    return found[[*KEYS, "printed", "mean", "tolerance", "verdict"]]

"""The published numbers, as CSV in `paper_tables/` with the same keys as our own results."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

FOLDER = Path(__file__).resolve().parents[2] / "paper_tables"


def published_main() -> pd.DataFrame:
    """Table 1: method, dataset, group, scene, metric, value, bold; averages are rows whose scene contains `Average`."""
    table = pd.read_csv(FOLDER / "table1.csv", keep_default_na=False)
    table["value"] = table["value"].astype(float)
    table["bold"] = table["bold"].astype(str).str.lower() == "true"
    return table


def published_ablation() -> pd.DataFrame:
    """Table 2: method, init, metric, value; means over the 14 scenes."""
    return pd.read_csv(FOLDER / "table2.csv")

"""Tables of experiments on the terminal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from rich.table import Table

from tdgbench.terminal import console


def show_table(table: pd.DataFrame, title: str | None = None) -> None:
    """Print a table."""
    view = Table(*map(str, table.columns), title=title)
    for row in table.itertuples(index=False):
        view.add_row(*(_text(value) for value in row))
    console().print(view)


def format_columns(table: pd.DataFrame, columns: Mapping[str, tuple[str, str]]) -> pd.DataFrame:
    """Return some columns of a table as text, `n/a` for missing numbers. columns: title and format by name.

    >>> format_columns(pd.DataFrame({"psnr": [24.061, np.nan]}), {"psnr": ("PSNR", "{:.2f} dB")})["PSNR"].tolist()
    ['24.06 dB', 'n/a']
    """
    return pd.DataFrame(
        {
            title: ["n/a" if pd.isna(value) else form.format(value) for value in table[name]]
            for name, (title, form) in columns.items()
        }
    )


def _text(value: object) -> str:
    """Format a value: three digits of a number."""
    if not isinstance(value, float):
        return str(value)
    if np.isnan(value):
        return "n/a"
    size = abs(value)
    return f"{value:.1e}" if 0 < size < 1e-2 else f"{value:,.0f}" if size >= 1000 else f"{value:.3g}"

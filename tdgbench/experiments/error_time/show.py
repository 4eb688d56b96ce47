"""Tables of the error-time experiment on the terminal."""

from __future__ import annotations

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table


def show(table: pd.DataFrame, console: Console, title: str) -> None:
    """Print a table."""
    view = Table(*map(str, table.columns), title=title)
    for row in table.itertuples(index=False):
        view.add_row(*(_text(value) for value in row))
    console.print(view)


def _text(value: object) -> str:
    """Three digits of a number; yes or nothing for a Boolean."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else ""
    if not isinstance(value, float):
        return str(value)
    if np.isnan(value):
        return "n/a"
    size = abs(value)
    return f"{value:.1e}" if 0 < size < 1e-2 else f"{value:,.0f}" if size >= 1000 else f"{value:.3g}"

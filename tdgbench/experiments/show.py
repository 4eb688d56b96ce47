"""Tables of experiments on the terminal."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from rich.table import Table
from rich.text import Text

from tdgbench.terminal import console
from tdgbench.text import one_line


def show_table(table: pd.DataFrame, title: str | None = None) -> None:
    """Print a table of text, none of which is rich's markup."""
    view = Table(*map(str, table.columns), title=title)
    for row in table.itertuples(index=False):
        view.add_row(*(Text(one_line(str(text))) for text in row))
    console().print(view)


def format_columns(table: pd.DataFrame, columns: Mapping[str, tuple[str, str]]) -> pd.DataFrame:
    """Return some columns of a table as text, `n/a` for missing numbers. columns: title and format by name.

    >>> format_columns(pd.DataFrame({"psnr": [24.061, float("nan")]}), {"psnr": ("PSNR", "{:.2f} dB")})["PSNR"].tolist()
    ['24.06 dB', 'n/a']
    """
    return pd.DataFrame(
        {
            title: ["n/a" if pd.isna(value) else form.format(value) for value in table[name]]
            for name, (title, form) in columns.items()
        }
    )

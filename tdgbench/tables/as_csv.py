"""Tables as CSV text (RFC 4180), whose names no spreadsheet takes for formulas."""

from __future__ import annotations

from collections.abc import Collection
from io import StringIO

import pandas as pd

from tdgbench.text import csv_text


def as_csv(table: pd.DataFrame, as_is: Collection[str] = (), na_rep: str = "") -> str:
    """Return CSV text. as_is: columns of text that begins with a number of ours. na_rep: for missing values.

    >>> print(as_csv(pd.DataFrame({"scene": ["=1+1", "a,b"], "value": [-1.5, 2.0]})), end="")
    scene,value
    '=1+1,-1.5
    "a,b",2.0
    """
    names = [c for c in table.columns if c not in as_is and not pd.api.types.is_numeric_dtype(table[c])]
    safe = {name: [csv_text(v) if isinstance(v, str) else v for v in table[name]] for name in names}
    rows = _Rows()
    table.assign(**safe).to_csv(rows, index=False, lineterminator=_Rows.END, na_rep=na_rep)
    return rows.getvalue()


def to_csv(table: pd.DataFrame) -> str:
    """Return CSV text: floats with six decimals, small ones with six digits; n/a for missing ones.

    >>> print(to_csv(pd.DataFrame({"scene": ["a", "b", "c"], "value": [1.25, float("nan"), 2.1e-7]})), end="")
    scene,value
    a,1.25
    b,n/a
    c,2.1e-07
    """
    table = table.copy()
    numbers = [name for name in table.columns if pd.api.types.is_float_dtype(table[name])]
    for name in numbers:
        table[name] = ["n/a" if pd.isna(v) else _digits(v) for v in table[name]]
    if "bold" in table:
        table["bold"] = table["bold"].map({True: "true", False: "false"})
    return as_csv(table, as_is=numbers)


def _digits(value: float) -> str:
    if value == 0:  # -0.0 as well
        return "0"
    return f"{value:.6f}".rstrip("0").rstrip(".") if abs(value) >= 0.001 else f"{value:.6g}"


class _Rows(StringIO):
    """Rows that `csv` ends with both line ends, so that it quotes fields that hold either; they get line feeds."""

    END = "\r\n"

    def write(self, text: str) -> int:
        super().write(text.removesuffix(self.END) + "\n")
        return len(text)

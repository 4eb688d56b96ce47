"""Tables as LaTeX (booktabs), with the paper's rows, groups and bold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from tdgbench.scenes.registry import GROUPS, SCENES
from tdgbench.tables import methods
from tdgbench.tables.long_table import initial_points, protocol_notes
from tdgbench.tables.measures import ABLATION_PAIRS, AVERAGE, MEASURES, OVERALL, PUBLISHED, digits
from tdgbench.tables.palette import COLUMN, MARK, is_marked, palette_notes
from tdgbench.text import one_line

LABELS = {scene.name: scene.label for scene in SCENES}
ESCAPES = {
    **{c: f"\\{c}" for c in "&%$#_{}"},
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": r"\textless{}",
    ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}", "…": r"\ldots{}", "–": "--", "—": "---",
    "→": r"$\to$", "±": r"$\pm$", "×": r"$\times$", "−": "$-$", "°": r"$^\circ$", "’": "'", "\N{NO-BREAK SPACE}": "~",
}  # fmt: skip
KNOWN_TO_PDFLATEX = range(0xC0, 0x100)  # accented letters of Latin-1, but for those that need another font encoding
NEED_T1 = "ÐÞðþ÷"
LATEX_MARK = r"$^\dagger$"


def escape(text: str) -> str:
    r"""Escape text for LaTeX, in one line. What pdflatex cannot print is given by its number.

    >>> print(escape("50 % of a_b"), escape("[a]"), escape("é 熱"))
    50 \% of a\_b {[}a] é \texttt{U+71B1}
    """
    escaped = "".join(_escaped(c) for c in text)
    # a bracket or star would be an argument of the `\\\\` before it
    return f"{{{escaped[0]}}}{escaped[1:]}" if escaped[:1] in ("[", "*") else escaped


def _escaped(c: str) -> str:
    if c in ESCAPES:
        return ESCAPES[c]
    if (c.isascii() and c.isprintable()) or (ord(c) in KNOWN_TO_PDFLATEX and c not in NEED_T1):
        return c
    return " " if c.isspace() else rf"\texttt{{U+{ord(c):04X}}}"


def tabular(
    columns: str, heads: Sequence[str], body: Sequence[str], notes: Sequence[str] = (), below: Sequence[str] = ()
) -> str:
    r"""Return a `tabular`, which needs the package booktabs. heads, body: lines. notes: comments before it.

    below: notes on MARK, printed below the table.

    >>> print(tabular("lr", ["& PSNR \\\\"], [r"\midrule", "a & 24.1 \\\\"]), end="")
    \begin{tabular}{lr}
    \toprule
    & PSNR \\
    \midrule
    a & 24.1 \\
    \bottomrule
    \end{tabular}
    """
    begin = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule"]
    marks = [rf"\multicolumn{{{len(columns)}}}{{l}}{{\footnotesize {LATEX_MARK}{escape(note.removeprefix(MARK))}}} \\"
             for note in below]  # fmt: skip
    notes = [f"% {one_line(note)}" for note in notes]
    return "\n".join([*notes, *begin, *heads, *body, r"\bottomrule", *marks, r"\end{tabular}", ""])


def main_table(rows: pd.DataFrame) -> str:
    """Return a standalone `tabular` of scenes down, methods × measures across; it needs the package booktabs."""
    columns = list(dict.fromkeys(rows["method"]))
    cells = {
        (r.method, r.dataset, r.scene, r.metric): _number(r.value, digits(r.metric, r.scene), r.bold)
        for r in rows.itertuples()
    }

    marked = {(r.dataset, r.scene) for r in rows.itertuples() if getattr(r, COLUMN, "")}

    def line(label: str, dataset: str, scene: str) -> str:
        values = [cells[m, dataset, scene, metric] for m in columns for metric in PUBLISHED]
        mark = LATEX_MARK if (dataset, scene) in marked else ""
        return f"{label}{mark} & {' & '.join(values)} \\\\"

    width, per_method = 1 + len(columns) * len(PUBLISHED), len(PUBLISHED)
    titles = [rf"\multicolumn{{{per_method}}}{{c}}{{{escape(methods.label(m))}}}" for m in columns]
    rules = [rf"\cmidrule(lr){{{2 + i * per_method}-{1 + (i + 1) * per_method}}}" for i in range(len(columns))]
    heads = [
        f"Dataset & {' & '.join(titles)} \\\\",
        "".join(rules),
        f" & {' & '.join(MEASURES[metric].latex_column for _ in columns for metric in PUBLISHED)} \\\\",
    ]
    lines = []
    single = rows[rows["scene"] != OVERALL]
    for dataset, of_dataset in single.groupby("dataset", sort=False):
        lines += [r"\midrule", rf"\multicolumn{{{width}}}{{l}}{{\textbf{{{escape(str(dataset))}}}}} \\"]
        scenes = of_dataset[of_dataset["scene"] != AVERAGE].drop_duplicates("scene")
        for group, members in scenes.groupby("group", sort=False):
            if group:
                title = escape(GROUPS.get(str(group), str(group)))
                lines.append(rf"\multicolumn{{{width}}}{{l}}{{\quad\textbf{{{title}}}}} \\")
            lines += [line(rf"\qquad {escape(LABELS.get(s, s))}", str(dataset), s) for s in members["scene"]]
        lines.append(line(r"\quad\textbf{Average}", str(dataset), AVERAGE))
    if (rows["scene"] == OVERALL).any():
        lines += [r"\midrule", line(r"\textbf{Average (Overall)}", "", OVERALL)]
    return tabular("l" + "c" * (width - 1), heads, lines, protocol_notes(rows), palette_notes(rows))


def ablation_table(rows: pd.DataFrame) -> str:
    """Return a `tabular` as the paper's Table 2: methods × inits down, PSNR / SSIM of views and models across.

    Several kinds of random points are named. rows: method, init, metric, value, bold, points.
    """
    several = sum(str(init).startswith("random") for init in rows["init"].unique()) > 1
    parts = " & ".join(MEASURES[psnr].images or "PSNR / SSIM" for psnr, _ in ABLATION_PAIRS)
    lines = []
    for method, group in rows.groupby("method", sort=False):
        lines.append(r"\midrule")
        for init in dict.fromkeys(group["init"]):
            values = group[group["init"] == init].set_index("metric")
            kind = str(init).removeprefix("random").strip("_") or "cameras"
            random = r"$\checkmark$" + (f" ({escape(kind)})" if several else "")
            marks = rf"{random} & $\times$" if str(init).startswith("random") else r"$\times$ & $\checkmark$"
            pairs = " & ".join(_pair(values, names) for names in ABLATION_PAIRS)
            mark = LATEX_MARK if is_marked(values) else ""
            lines.append(f"{escape(methods.label(str(method)))}{mark} & {marks} & {pairs} \\\\")
    heads = [rf" & Random & COLMAP & {parts} \\"]
    return tabular("lcc" + "c" * len(ABLATION_PAIRS), heads, lines, initial_points(rows), palette_notes(rows))


def _pair(values: pd.DataFrame, names: Sequence[str]) -> str:
    """Return PSNR / SSIM of a model and its views; bold if either is best."""
    text = " / ".join(_number(values.loc[name, "value"], digits(name, OVERALL), False) for name in names)
    return rf"\textbf{{{text}}}" if bool(values.loc[list(names), "bold"].any()) else text


def _number(value: float, places: int, bold: bool) -> str:
    if np.isnan(value):
        return "n/a"
    text = f"{value:.{places}f}"
    return rf"\textbf{{{text}}}" if bold else text

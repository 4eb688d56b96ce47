"""Tables as LaTeX (booktabs), with the paper's rows, groups and bold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from tdgbench.scenes.registry import GROUPS, SCENES
from tdgbench.tables import methods
from tdgbench.tables.measures import (
    ABLATION_PAIRS,
    AVERAGE,
    GAUSSIANS,
    OVERALL,
    PUBLISHED,
    PUBLISHED_SCORES,
    digits,
    measure,
)
from tdgbench.tables.readings import COMPARED, widest_average, with_setup
from tdgbench.tables.results import first_points, split_notes
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


def escape(text: str) -> str:
    r"""Escape text for LaTeX, in one line. What pdflatex cannot print is given by its number.

    >>> print(escape("50 % of a_b"), escape("[a]"), escape("é 熱"))
    50 \% of a\_b {[}a] é \texttt{U+71B1}
    """
    found = "".join(_escaped(c) for c in text)
    return (
        f"{{{found[0]}}}{found[1:]}" if found[:1] in ("[", "*") else found
    )  # else an argument of the `\\\\` before it


def _escaped(c: str) -> str:
    if c in ESCAPES:
        return ESCAPES[c]
    if (c.isascii() and c.isprintable()) or (ord(c) in KNOWN_TO_PDFLATEX and c not in NEED_T1):
        return c
    return " " if c.isspace() else rf"\texttt{{U+{ord(c):04X}}}"


def comment(text: str) -> str:
    """Return a line of LaTeX that is not printed."""
    return f"% {one_line(text)}"


def main_table(rows: pd.DataFrame) -> str:
    """Return a standalone `tabular` of scenes down, methods × measures across; it needs the package booktabs."""
    columns = list(dict.fromkeys(rows["method"]))
    cells = {
        (r.method, r.dataset, r.scene, r.metric): _number(r.value, digits(r.metric, r.scene), r.bold)
        for r in rows.itertuples()
    }

    def line(label: str, dataset: str, scene: str) -> str:
        values = [cells[m, dataset, scene, metric] for m in columns for metric in PUBLISHED]
        return f"{label} & {' & '.join(values)} \\\\"

    width, per_method = 1 + len(columns) * len(PUBLISHED), len(PUBLISHED)
    heads = [rf"\multicolumn{{{per_method}}}{{c}}{{{_method(m)}}}" for m in columns]
    rules = [rf"\cmidrule(lr){{{2 + i * per_method}-{1 + (i + 1) * per_method}}}" for i in range(len(columns))]
    lines = [
        *(comment(note) for note in split_notes(rows)),
        rf"\begin{{tabular}}{{l{'c' * (width - 1)}}}",
        r"\toprule",
        f"Dataset & {' & '.join(heads)} \\\\",
        "".join(rules),
        f" & {' & '.join(measure(metric).latex_column for _ in columns for metric in PUBLISHED)} \\\\",
    ]
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
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def papers_table(rows: pd.DataFrame) -> str:
    """Return a `tabular` of scenes down; for each score the papers' numbers, in the comment's order, and their spread.

    rows: from `between_papers`.
    """
    orders = dict.fromkeys(
        "; ".join(part.rsplit(" ", 1)[0] for part in values.split("; ")) for values in rows["values"]
    )
    metrics = list(dict.fromkeys(rows["metric"]))
    lines = [
        *(comment(order) for order in orders),
        *(comment(note) for note in dict.fromkeys(rows["note"]) if note),
        rf"\begin{{tabular}}{{ll{'cc' * len(metrics)}}}",
        r"\toprule",
        f" & & {' & '.join(f'{measure(metric).latex_column} & spread' for metric in metrics)} \\\\",
        r"\midrule",
    ]
    for (method, _, scene), group in rows.groupby(["method", "dataset", "scene"], sort=False):
        by_metric, cells = group.set_index("metric"), []
        for metric in metrics:
            if metric in by_metric.index:
                texts = [part.rsplit(" ", 1)[1] for part in by_metric.loc[metric, "values"].split("; ")]
                cells += [" / ".join(texts), f"{by_metric.loc[metric, 'spread']:.{digits(metric)}f}"]
            else:
                cells += ["n/a", "n/a"]
        lines.append(
            f"{_method(str(method))} & {escape(LABELS.get(str(scene), str(scene)))} & {' & '.join(cells)} \\\\"
        )
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def ablation_table(rows: pd.DataFrame) -> str:
    """Return a `tabular` as the paper's Table 2: methods × inits down, PSNR / SSIM of views and models across.

    Several kinds of random points are named.

    rows: method, init, metric, value, bold, points.
    """
    several = sum(str(init).startswith("random") for init in rows["init"].unique()) > 1
    lines = [
        *(comment(how) for how in first_points(rows)),
        rf"\begin{{tabular}}{{lcc{'c' * len(ABLATION_PAIRS)}}}",
        r"\toprule",
        rf" & Random & COLMAP & {' & '.join(measure(psnr).part or 'PSNR / SSIM' for psnr, _ in ABLATION_PAIRS)} \\",
    ]
    for method, group in rows.groupby("method", sort=False):
        lines.append(r"\midrule")
        for init in dict.fromkeys(group["init"]):
            values = group[group["init"] == init].set_index("metric")
            kind = str(init).removeprefix("random").strip("_") or "cameras"
            random = r"$\checkmark$" + (f" ({escape(kind)})" if several else "")
            marks = rf"{random} & $\times$" if str(init).startswith("random") else r"$\times$ & $\checkmark$"
            pairs = " & ".join(_pair(values, names) for names in ABLATION_PAIRS)
            lines.append(f"{_method(str(method))} & {marks} & {pairs} \\\\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def readings_table(rows: pd.DataFrame, changes: pd.DataFrame) -> str:
    """Return two tabulars: average scores by method and iterations, and the change that each difference makes.

    rows: from `readings`. changes: from `effects`. With one scene, its numbers take the place of an average.
    """
    rows, changes = with_setup(widest_average(rows), "method"), with_setup(widest_average(changes), "effect")
    lines = _head("Method", [*(measure(m).latex_column for m in PUBLISHED), GAUSSIANS.label])
    for (method, length), group in rows.groupby(["method", "iterations"], sort=False):
        values = group.set_index("metric")
        numbers = [_spread(values, m) for m in COMPARED]
        lines.append(f"{_method(str(method))} & {length} & {' & '.join(numbers)} \\\\")
    lines += [r"\bottomrule", r"\end{tabular}", ""]
    lines += _head("Change", [*(measure(m).latex_column for m in PUBLISHED_SCORES), r"Time $\times$"])
    for (effect, lengths), group in changes.groupby(["effect", "iterations"], sort=False):
        values = group.set_index("metric")
        numbers = [_change(values, m) for m in PUBLISHED]
        lines.append(f"{escape(str(effect))} & {escape(str(lengths))} & {' & '.join(numbers)} \\\\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _head(first: str, titles: list[str]) -> list[str]:
    """Return opening lines of a tabular with the columns `first`, iterations and `titles`."""
    return [
        rf"\begin{{tabular}}{{lr{'c' * len(titles)}}}",
        r"\toprule",
        f"{first} & Iterations & {' & '.join(titles)} \\\\",
        r"\midrule",
    ]


def _spread(values: pd.DataFrame, metric: str) -> str:
    if metric not in values.index:
        return "n/a"
    value, std = float(values.loc[metric, "value"]), float(values.loc[metric, "std"])
    text = _number(value, digits(metric), False)
    return text if np.isnan(std) or measure(metric).ratio else rf"{text} $\pm$ {std:.{digits(metric)}f}"


def _change(values: pd.DataFrame, metric: str) -> str:
    if metric not in values.index:
        return "n/a"
    row = values.loc[metric]
    form = ".2f" if measure(metric).ratio else f"+.{digits(metric)}f"
    text = f"{row['change']:{form}}"
    return text if np.isnan(row["low"]) else f"{text} [{row['low']:{form}}, {row['high']:{form}}]"


def _pair(values: pd.DataFrame, names: Sequence[str]) -> str:
    """Return PSNR / SSIM of a model and its views; bold if either is best."""
    text = " / ".join(_number(values.loc[name, "value"], digits(name, OVERALL), False) for name in names)
    return rf"\textbf{{{text}}}" if bool(values.loc[list(names), "bold"].any()) else text


def _method(column: str) -> str:
    return escape(methods.label(column))


def _number(value: float, places: int, bold: bool) -> str:
    if np.isnan(value):
        return "n/a"
    text = f"{value:.{places}f}"
    return rf"\textbf{{{text}}}" if bold else text

"""The tables as LaTeX (booktabs), in the paper's rows, groups and bold."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tdgbench.scenes.registry import GROUPS, SCENES
from tdgbench.tables.results import AVERAGE, DECIMALS, METRICS, OVERALL, decimals, first_points

HEADERS = {
    "psnr": r"PSNR $\uparrow$",
    "ssim": r"SSIM $\uparrow$",
    "lpips": r"LPIPS $\downarrow$",
    "hours": r"Time [h] $\downarrow$",
}
METHOD_NAMES = {"msmg": "MSMG", "tdg": "TDg", "splat": "3DGS"}
LABELS = {scene.name: scene.label for scene in SCENES}
ESCAPES = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}


def escape(text: str) -> str:
    """Text as LaTeX."""
    return "".join(ESCAPES.get(c, f"\\{c}" if c in "&%$#_{}" else c) for c in text)


def main_table(rows: pd.DataFrame) -> str:
    """Scenes down, methods × metrics across; a standalone `tabular` that needs the package booktabs."""
    methods = list(dict.fromkeys(rows["method"]))
    cells = {
        (r.method, r.dataset, r.scene, r.metric): _number(r.value, decimals(r.metric, r.scene), r.bold)
        for r in rows.itertuples()
    }

    def line(label: str, dataset: str, scene: str) -> str:
        values = [cells[m, dataset, scene, metric] for m in methods for metric in METRICS]
        return f"{label} & {' & '.join(values)} \\\\"

    width = 1 + len(methods) * len(METRICS)
    heads = [rf"\multicolumn{{{len(METRICS)}}}{{c}}{{{_method(m)}}}" for m in methods]
    rules = [rf"\cmidrule(lr){{{2 + i * len(METRICS)}-{1 + (i + 1) * len(METRICS)}}}" for i in range(len(methods))]
    lines = [
        rf"\begin{{tabular}}{{l{'c' * (width - 1)}}}",
        r"\toprule",
        f"Dataset & {' & '.join(heads)} \\\\",
        "".join(rules),
        f" & {' & '.join(HEADERS[metric] for _ in methods for metric in METRICS)} \\\\",
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
    """Scenes down; for each score what each paper prints, in the order of the comment, and how far they are apart.

    rows: as `between_papers` makes them.
    """
    orders = dict.fromkeys(
        "; ".join(part.rsplit(" ", 1)[0] for part in values.split("; ")) for values in rows["values"]
    )
    metrics = list(dict.fromkeys(rows["metric"]))
    lines = [
        *(f"% {order}" for order in orders),
        *(f"% {note}" for note in dict.fromkeys(rows["note"]) if note),
        rf"\begin{{tabular}}{{ll{'cc' * len(metrics)}}}",
        r"\toprule",
        f" & & {' & '.join(f'{HEADERS[metric]} & spread' for metric in metrics)} \\\\",
        r"\midrule",
    ]
    for (method, _, scene), own in rows.groupby(["method", "dataset", "scene"], sort=False):
        by_metric, cells = own.set_index("metric"), []
        for metric in metrics:
            if metric in by_metric.index:
                texts = [part.rsplit(" ", 1)[1] for part in by_metric.loc[metric, "values"].split("; ")]
                cells += [" / ".join(texts), f"{by_metric.loc[metric, 'spread']:.{DECIMALS[metric]}f}"]
            else:
                cells += ["n/a", "n/a"]
        lines.append(
            f"{_method(str(method))} & {escape(LABELS.get(str(scene), str(scene)))} & {' & '.join(cells)} \\\\"
        )
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def ablation_table(rows: pd.DataFrame) -> str:
    """Methods × inits down, PSNR / SSIM across, as the paper's Table 2, and those of the training views beside them.

    rows: method, init, metric, value, bold, points.
    """
    lines = [
        *(f"% {how}" for how in first_points(rows)),
        r"\begin{tabular}{lcccc}",
        r"\toprule",
        r" & Random & COLMAP & PSNR / SSIM & training views \\",
    ]
    for method, own in rows.groupby("method", sort=False):
        lines.append(r"\midrule")
        for init in dict.fromkeys(own["init"]):
            values = own[own["init"] == init].set_index("metric")
            marks = " & ".join(r"$\checkmark$" if init == i else r"$\times$" for i in ("random", "colmap"))
            pairs = " & ".join(_pair(values, part) for part in ("", "train_"))
            lines.append(f"{_method(str(method))} & {marks} & {pairs} \\\\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _pair(values: pd.DataFrame, part: str) -> str:
    """PSNR / SSIM of test views or, with the part `train_`, of training views; bold if one of them is."""
    names = [f"{part}psnr", f"{part}ssim"]
    text = " / ".join(_number(values.loc[name, "value"], decimals(name, OVERALL), False) for name in names)
    return rf"\textbf{{{text}}}" if bool(values.loc[names, "bold"].any()) else text


def _method(label: str) -> str:
    name, _, rest = label.partition(" ")
    return escape(f"{METHOD_NAMES.get(name, name)} {rest}".strip())


def _number(value: float, digits: int, bold: bool) -> str:
    if np.isnan(value):
        return "n/a"
    text = f"{value:.{digits}f}"
    return rf"\textbf{{{text}}}" if bold else text

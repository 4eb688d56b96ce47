"""The tables as LaTeX (booktabs), in the paper's rows, groups and bold."""

from __future__ import annotations

import numpy as np
import pandas as pd

from tdgbench.scenes.registry import GROUPS, SCENES
from tdgbench.tables.readings import widest_average, with_setup
from tdgbench.tables.results import AVERAGE, DECIMALS, METRICS, OVERALL, decimals, first_points, split_notes

HEADERS = {
    "psnr": r"PSNR $\uparrow$",
    "ssim": r"SSIM $\uparrow$",
    "lpips": r"LPIPS $\downarrow$",
    "hours": r"Time [h] $\downarrow$",
}
METHOD_NAMES = {
    "msmg": "MSMG",
    "thermal": "MSMG's thermal model",
    "splat": "3DGS",
    "splat_smooth": "3DGS, smooth",
    "tdg": "TDg",
    "tdg_released": "TDg as released",
    "tdg_switch": "TDg, switched",
}
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
        *(f"% {note}" for note in split_notes(rows)),
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
    """Methods × inits down, PSNR / SSIM across, as the paper's Table 2; beside them those of the training views and of
    the RGB model. Several kinds of random points are named.

    rows: method, init, metric, value, bold, points.
    """
    several = sum(str(init).startswith("random") for init in rows["init"].unique()) > 1
    lines = [
        *(f"% {how}" for how in first_points(rows)),
        r"\begin{tabular}{lccccc}",
        r"\toprule",
        r" & Random & COLMAP & PSNR / SSIM & training views & RGB model \\",
    ]
    for method, own in rows.groupby("method", sort=False):
        lines.append(r"\midrule")
        for init in dict.fromkeys(own["init"]):
            values = own[own["init"] == init].set_index("metric")
            kind = str(init).removeprefix("random").strip("_") or "cameras"
            random = r"$\checkmark$" + (f" ({escape(kind)})" if several else "")
            marks = rf"{random} & $\times$" if str(init).startswith("random") else r"$\times$ & $\checkmark$"
            pairs = " & ".join(_pair(values, part) for part in ("", "train_", "rgb_"))
            lines.append(f"{_method(str(method))} & {marks} & {pairs} \\\\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def readings_table(rows: pd.DataFrame, changes: pd.DataFrame) -> str:
    """Two tabulars: average scores by method and iterations, and what each difference changes, with its interval.

    rows: as `readings` makes them. changes: as `effects` makes them. A single scene stands for itself.
    """
    rows, changes = with_setup(widest_average(rows), "method"), with_setup(widest_average(changes), "effect")
    metrics = ("psnr", "ssim", "lpips", "hours", "gaussians")
    titles = [*(HEADERS[m] for m in metrics[:4]), "Gaussians"]
    lines = [r"\begin{tabular}{lrccccc}", r"\toprule", f"Method & Iterations & {' & '.join(titles)} \\\\", r"\midrule"]
    for (method, length), own in rows.groupby(["method", "iterations"], sort=False):
        values = own.set_index("metric")
        numbers = [_spread(values, m) for m in metrics]
        lines.append(f"{_method(str(method))} & {length} & {' & '.join(numbers)} \\\\")
    lines += [r"\bottomrule", r"\end{tabular}", ""]
    compared = ("psnr", "ssim", "lpips", "hours")
    titles, arrow = [*(HEADERS[m] for m in compared[:3]), r"Time $\times$"], r"$\to$"
    lines += [r"\begin{tabular}{lrcccc}", r"\toprule", f"Change & Iterations & {' & '.join(titles)} \\\\", r"\midrule"]
    for (effect, words), own in changes.groupby(["effect", "iterations"], sort=False):
        values = own.set_index("metric")
        numbers = [_change(values, m) for m in compared]
        lines.append(f"{escape(str(effect))} & {str(words).replace('→', arrow)} & {' & '.join(numbers)} \\\\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _spread(values: pd.DataFrame, metric: str) -> str:
    if metric not in values.index:
        return "n/a"
    value, std = float(values.loc[metric, "value"]), float(values.loc[metric, "std"])
    if metric == "gaussians":
        return f"{value:.0f}"
    text = _number(value, decimals(metric, AVERAGE), False)
    return text if np.isnan(std) or metric == "hours" else rf"{text} $\pm$ {std:.{decimals(metric, AVERAGE)}f}"


def _change(values: pd.DataFrame, metric: str) -> str:
    if metric not in values.index:
        return "n/a"
    row = values.loc[metric]
    digits, sign = (2, "") if metric == "hours" else (decimals(metric, AVERAGE), "+")
    text = f"{row['change']:{sign}.{digits}f}"
    if np.isnan(row["low"]):
        return text
    return f"{text} [{row['low']:{sign}.{digits}f}, {row['high']:{sign}.{digits}f}]"


def _pair(values: pd.DataFrame, part: str) -> str:
    """PSNR / SSIM of test views, training views (part `train_`) or the RGB model (`rgb_`); bold if one of them is."""
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

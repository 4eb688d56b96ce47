"""The tables on the terminal."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tdgbench.tables.averages import FOLLOWS, OFF, UNKNOWN
from tdgbench.tables.build import ABLATION_METRICS, Tables
from tdgbench.tables.claims import FAILS, HOLDS, UNDECIDED
from tdgbench.tables.readings import changes_as_text, widest_average, with_setup
from tdgbench.tables.results import METRICS, OVERALL, decimals, first_points, split_notes
from tdgbench.tables.verdicts import in_words

HEADERS = {"psnr": "PSNR↑", "ssim": "SSIM↑", "lpips": "LPIPS↓", "hours": "time↓"}


def show(tables: Tables, console: Console) -> None:
    """Print the main table, and how far it is from the published one."""
    if tables.kind == "ablation":
        _show_ablation(tables, console)
    elif tables.readings is not None and tables.effects is not None:
        _show_readings(tables.readings, tables.effects, console)
    else:
        _show_main(tables, console)
        for note in split_notes(tables.main):
            console.print(note, highlight=False, soft_wrap=True)
    _show_reasons(tables, console)
    if tables.difference is not None:
        known = tables.difference["difference"].notna()
        console.print(
            f"{int(known.sum())} of {len(known)} published numbers have one of ours beside them; "
            f"differences: {tables.folder / 'difference.csv'}",
            highlight=False,
        )
        for metric, own in tables.difference[known].groupby("metric", sort=False):
            spread = own["difference"]
            said = f"  {metric}: ours − published {spread.min():+.3f} to {spread.max():+.3f}, mean {spread.mean():+.3f}"
            console.print(f"{said}; {in_words(own)}", highlight=False, soft_wrap=True)
    if tables.papers is not None:
        show_papers(tables.papers, console)
    _show_comparisons(tables, console)


def show_claims(claims: pd.DataFrame, console: Console) -> None:
    """Print each claim with what the published table and ours say of it."""
    colors = {HOLDS: "green", FAILS: "red", UNDECIDED: "dim"}
    table = Table("claim", "published table", "our results", show_lines=True)
    for row in claims.to_dict("records"):
        sides = [
            f"[{colors[row[side]]}]{row[side]}[/{colors[row[side]]}]: {escape(str(row[f'{side}_seen']))}"
            for side in ("published", "ours")
        ]
        table.add_row(escape(str(row["said"])), *sides)
    console.print(table)


def show_averages(averages: pd.DataFrame, console: Console) -> None:
    """Print which papers' averages do not follow from their rows. averages: as `all_averages` makes them."""
    for source, own in averages.groupby("source", sort=False):
        counts = own["verdict"].value_counts()
        said = ", ".join(f"{counts[v]} {v}" for v in (FOLLOWS, OFF, UNKNOWN) if v in counts)
        console.print(f"averages of {source}, held against their rows: {said}", highlight=False, soft_wrap=True)
        for row in own[own["verdict"] == OFF].itertuples():
            mean = f"{row.mean:.4f} ± {row.tolerance:.4f}"
            text = f"  {row.method} {row.metric}: printed {row.printed}, mean of the rows {mean}"
            console.print(text, highlight=False, soft_wrap=True)


def show_papers(papers: pd.DataFrame, console: Console) -> None:
    """Print how far papers are apart, by method and score, and where most. papers: as `between_papers` makes them."""
    for (method, metric), own in papers[papers["scenes"] == 1].groupby(["method", "metric"], sort=False):
        widest = own.loc[own["spread"].idxmax()]
        digits = decimals(str(metric), widest["scene"])
        median, most = f"{own['spread'].median():.{digits}f}", f"{widest['spread']:.{digits}f} at {widest['scene']}"
        said = f"  {metric} of {method} differs between papers by {median} in the median scene, by {most}"
        console.print(said, highlight=False, soft_wrap=True)
    for note in dict.fromkeys(papers["note"]):
        if note:
            console.print(f"  {escape(note)}", highlight=False, soft_wrap=True)


def _show_comparisons(tables: Tables, console: Console) -> None:
    """TDg against MSMG: over scenes, and in time."""
    if tables.paired is not None:
        for row in tables.paired.itertuples():
            if not np.isnan(row.p):
                console.print(
                    f"TDg is better in {row.metric} on {row.better} of {row.scenes} scenes (Wilcoxon p = {row.p:.3g})",
                    highlight=False,
                )
    if tables.speed is not None and tables.speed["published"].notna().any():
        both = tables.speed.dropna()
        gap = (both["ours"] / both["published"] - 1).abs()
        console.print(
            f"time TDg / MSMG: {both['ours'].mean():.2f}, published {both['published'].mean():.2f}; "
            f"{int((gap < 0.1).sum())} of {len(both)} within 10 %",
            highlight=False,
        )


def _show_main(tables: Tables, console: Console) -> None:
    main = tables.main
    methods = list(dict.fromkeys(main["method"]))
    table = Table("scene", "method")
    for metric in METRICS:
        table.add_column(HEADERS[metric], justify="right")
    values = {(r.method, r.dataset, r.scene, r.metric): r for r in main.itertuples()}
    for (dataset, scene), _ in main.groupby(["dataset", "scene"], sort=False):
        for method in methods:
            cells = []
            for metric in METRICS:
                row = values[method, dataset, scene, metric]
                text = "n/a" if np.isnan(row.value) else _text(row.value, metric, scene)
                if not np.isnan(row.std) and metric != "hours":
                    text += f" ± {_text(row.std, metric, scene)}"
                cells.append(f"[bold]{text}[/bold]" if row.bold else text)
            title = scene if method == methods[0] else ""
            table.add_row(title, escape(method), *cells, end_section=method == methods[-1])
    console.print(table)


def _text(value: float, metric: str, scene: str) -> str:
    """A number as it is printed; times as h:mm:ss."""
    return (
        str(timedelta(hours=round(value * 3600) / 3600))
        if metric == "hours"
        else f"{value:.{decimals(metric, scene)}f}"
    )


def _show_ablation(tables: Tables, console: Console) -> None:
    heads = (f"{name}{part}" for part in ("", ", training views", ", RGB model") for name in ("PSNR↑", "SSIM↑"))
    table = Table("method", "first points", *heads)
    for (method, init), own in tables.main.groupby(["method", "init"], sort=False):
        values = own.set_index("metric")["value"]
        texts = ["n/a" if np.isnan(values[m]) else _text(values[m], m, OVERALL) for m in ABLATION_METRICS]
        table.add_row(escape(str(method)), str(init), *texts)
    console.print(table)
    for how in first_points(tables.main):
        console.print(how, highlight=False, soft_wrap=True)


def _show_readings(readings: pd.DataFrame, effects: pd.DataFrame, console: Console) -> None:
    """Averages by method and length, then what each difference changes, with its 95 % interval over seeds.

    Single scenes stand in readings.csv and effects.csv.
    """
    table = Table("method", "iterations", "scene", *HEADERS.values(), "Gaussians")
    for (method, iterations, scene), own in with_setup(widest_average(readings), "method").groupby(
        ["method", "iterations", "scene"], sort=False
    ):
        values = own.groupby("metric")["value"].mean()
        texts = [_text(values[m], m, str(scene)) if m in values else "n/a" for m in METRICS]
        table.add_row(escape(method), str(iterations), escape(str(scene)), *texts, f"{values['gaussians']:.0f}")
    console.print(table)
    heads, rows = changes_as_text(effects)
    table = Table(*heads)
    for row in rows:
        table.add_row(*(escape(text) for text in row))
    console.print(table)


def _show_reasons(tables: Tables, console: Console) -> None:
    lacking = tables.main[tables.main["value"].isna() & tables.main["metric"].isin(METRICS)]
    for reason, own in lacking.groupby("reason", sort=False):
        metrics = ", ".join(dict.fromkeys(own["metric"]))
        console.print(f"n/a ({len(own)} × {metrics}): {escape(str(reason))}", highlight=False, soft_wrap=True)

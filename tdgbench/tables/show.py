"""Tables on the terminal."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import groupby

import numpy as np
import pandas as pd
from rich.table import Column, Table
from rich.text import Text

from tdgbench.present.grid import GridCell
from tdgbench.scoring import METRICS
from tdgbench.tables.assumptions import doubts_of
from tdgbench.tables.build import Tables
from tdgbench.tables.claims.evidence import FAILS, HOLDS, UNDECIDED, JudgedClaim
from tdgbench.tables.columns import own_columns
from tdgbench.tables.grids import RANGE_TITLE, failed_metrics, reasons_for_na
from tdgbench.tables.long_table import RANGE
from tdgbench.tables.measures import ABLATION, HOURS, as_text, measure_of
from tdgbench.tables.palette import MARK, with_mark
from tdgbench.tables.readings import SHOWN, changes_as_text, widest_average, with_setup
from tdgbench.tables.setup_notes import setup_facts
from tdgbench.tables.verdicts import scores_of, verdicts_in_words
from tdgbench.terminal import console, say
from tdgbench.text import one_line

MOST_DOUBTS = 12
HOW_TO_READ = (
    "change: of a cell's score, from the convention of its record to this one. reversed pairs: two cells of one scene "
    "and seed, of which the other is better now; n seeds make n pairs. other best: in so many scenes and seeds another "
    "cell is the best. Both count any change, however small. ranks agree: mean over scenes and seeds with three cells "
    "or more, else n/a"
)
BOLD = "*"  # marks bold type where there is no terminal
WIDEST_HEAD = 16  # characters of a heading in one line
PROSE = 60  # characters of a column of sentences where there is no terminal, and so no width to share


def show_table(table: pd.DataFrame, title: str | None = None) -> None:
    """Print a table of text, none of which is rich's markup."""
    view = Table(*map(str, table.columns), title=title)
    for row in table.itertuples(index=False):
        view.add_row(*map(_name, row))
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


def show_tables(tables: Tables) -> None:
    """Print the main table and its differences from the published one; `show_findings` follows."""
    with own_columns(tables.results.plan):
        if tables.is_ablation:
            _show_ablation(tables)
        elif tables.readings is not None and tables.effects is not None:
            _show_readings(tables.readings, tables.effects)
        else:
            _show_main(tables)
        shown = [*tables.grid.names, *([] if tables.is_ablation else failed_metrics(tables.main))]
        finished = [cell.record for cell in tables.results.finished]
        timed = HOURS.name in tables.grid.names
        if tables.main["bold"].any() and not console().is_terminal:
            say(f"{BOLD}: bold type, which this output has not")
        notes = *tables.grid.notes, *_beside(tables.grid.names), *reasons_for_na(tables.main, shown)
        for note in (*notes, *setup_facts(finished, timed)):
            say(one_line(note))
    show_problems(tables.problems)
    show_doubts(doubts_of(tables.records))
    if tables.difference is not None:
        known = tables.difference["difference"].notna()
        scores = len(scores_of(tables.difference))
        counted = (
            f"{int(known.sum())} of {len(known)} published numbers ({scores} scores, and {len(known) - scores} times, "
            "which get no verdict) have one of ours beside them"
        )
        say(f"{counted}; differences: {tables.folder / 'difference.csv'}")
        for metric, group in tables.difference[known].groupby("metric", sort=False):
            gap = group["difference"]
            text = f"  {metric}: ours − published {gap.min():+.3f} to {gap.max():+.3f}, mean {gap.mean():+.3f}"
            say(f"{text}; {verdicts_in_words(group)}")


def show_claims(claims: Iterable[JudgedClaim]) -> None:
    """Print each claim with its findings on the published table and on our results."""
    colors = {HOLDS: "green", FAILS: "red", UNDECIDED: "dim"}
    widest = None if console().is_terminal else PROSE
    heads = ("claim", "published table", "our results")
    table = Table(*(Column(head, max_width=widest) for head in heads), show_lines=True)
    for claim in claims:
        findings = ((claim.published, claim.published_seen), (claim.ours, claim.ours_seen))
        sides = [Text.assemble((verdict, colors[verdict]), f": {grounds}") for verdict, grounds in findings]
        table.add_row(Text(f"{claim.paper}: {claim.said}"), *sides)
    console().print(table)


def show_sensitivity(sensitivity: pd.DataFrame) -> None:
    """Print how far each convention moves the scores, and what it changes in the order of methods."""
    rows = []
    for row in sensitivity.to_dict("records"):
        numbers = ["n/a"] * 5
        if row["cells"]:
            changes = (as_text(row["score"], row[name], form="+.3f") for name in ("mean_change", "largest_change"))
            ranks = f"{row['rank_correlation']:.2f} (in {row['ranked']})" if row["ranked"] else "n/a"
            best = f"{row['other_best']} of {row['groups']}"
            numbers = [*changes, f"{row['reversed']} of {row['pairs']}", best, ranks]
        rows.append([measure_of(row["score"]).label, row["convention"], *numbers])
    heads = ["score", "convention", "change: mean", "largest", "reversed pairs", "other best", "ranks agree (Spearman)"]
    show_table(pd.DataFrame(rows, columns=heads))
    of_some = np.where(sensitivity["cells"] > 0, " in some cells", "")
    say(HOW_TO_READ)
    for reason in ("n/a" + of_some + ": " + sensitivity["reason"])[sensitivity["reason"] != ""].unique():
        say(one_line(reason))


def show_problems(problems: list[str]) -> None:
    """Print what could not be read."""
    for problem in problems:
        say(one_line(problem), "problem:")


def show_doubts(doubts: list[str]) -> None:
    """Print what is doubted of the scenes' cameras and points; the report has all of it."""
    for doubt in doubts[:MOST_DOUBTS]:
        say(one_line(doubt), "doubt:")
    if len(doubts) > MOST_DOUBTS:
        say(f"{len(doubts) - MOST_DOUBTS} more, which the report has", "doubt:")


def _name(name: object) -> Text:
    """Return a name in a table: no markup, one line."""
    return Text(one_line(str(name)))


def _show_main(tables: Tables) -> None:
    """Print the main table: methods of a scene together, under the scene's name."""
    grid, table = tables.grid, Table("scene", "method")
    for name in grid.names:
        head = RANGE_TITLE if name == RANGE else measure_of(name).column
        table.add_column(head if len(head) < WIDEST_HEAD else head.replace(" ", "\n", 1), justify="right")
    for (_, scene), group in groupby(grid.rows, key=lambda row: row.place[:2]):
        rows = list(group)
        title = f"{scene} {MARK}" if any(row.is_marked for row in rows) else scene
        for row in rows:
            table.add_row(_name(title), _name(row.heads[2]), *map(_number, row.cells), end_section=row is rows[-1])
            title = ""
    console().print(table)


def _number(cell: GridCell) -> Text:
    """Return a number; bold type needs a terminal."""
    return Text(cell.text + f" {BOLD}" * (cell.bold and not console().is_terminal), "bold" if cell.bold else "")


def _beside(names: Iterable[str]) -> list[str]:
    """Return what the shown columns mean that stand beside a score."""
    shown = [measure_of(name) for name in names if name in METRICS and METRICS[name].beside]
    return [f"{measure.label}: {measure.meaning}" for measure in shown]


def _show_ablation(tables: Tables) -> None:
    described = [measure_of(metric) for metric in ABLATION]
    heads = (metric.column + (f", {metric.images}" if metric.images else "") for metric in described)
    table = Table("method", "initial points", *heads)
    for row in tables.grid.rows:
        table.add_row(*map(_name, row.heads), *map(_number, row.cells))
    console().print(table)


def _show_readings(readings: pd.DataFrame, effects: pd.DataFrame) -> None:
    """Print averages by method and length, then the change of each difference, with its 95 % interval over seeds.

    Single scenes are in readings.csv and effects.csv.
    """
    rows = []
    for names, group in with_setup(widest_average(readings), "method").groupby(
        ["method", "iterations", "scene"], sort=False
    ):
        values = group.groupby("metric")["value"].mean()
        named = [*names[:2], with_mark(str(names[2]), group)]
        rows.append([*named, *(as_text(m, values[m], str(names[2])) if m in values else "n/a" for m in SHOWN)])
    heads = ["method", "iterations", "scene", *(measure_of(m).column for m in SHOWN)]
    show_table(pd.DataFrame(rows, columns=heads))
    heads, rows = changes_as_text(effects)
    show_table(pd.DataFrame(rows, columns=heads))

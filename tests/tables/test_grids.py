"""Grids of scores: numbers, spreads, published numbers and verdicts beside them, and what the report says of them."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
import pytest

from tdgbench.cells.plan import MetricEntry, Plan
from tdgbench.report.report_page import legend, published_section, write_report
from tdgbench.tables.build import build_tables
from tdgbench.tables.grids import difference_note, further_grid
from tdgbench.tables.measures import measure_of
from tdgbench.tables.show import show_tables
from tdgbench.text import duration
from tests.helpers.records import write


def test_further_scores_are_those_that_a_cell_has(tmp_path):
    write(tmp_path, scene="orbit", dataset="synthetic", scores={"depth_abs_rel": 0.25, "rgb_psnr": None})
    tables = build_tables(tmp_path)
    found = further_grid(tables.main)
    assert found.columns == ["depth error ↓"]
    assert [row.cells[0].text for row in found.rows] == ["0.250"]  # no average of one scene
    assert tables.grid.rows[0].heads == ("synthetic", "orbit", "TDg")
    needs = {row["title"]: row["needs"] for row in legend(tables)}
    assert needs["depth error ↓"] == "true depth" and needs["PSNR, dB ↑"] == ""
    write(tmp_path / "plain", scene="orbit", dataset="synthetic")
    assert further_grid(build_tables(tmp_path / "plain").main) is None


def test_a_metric_of_the_user_that_failed_is_told(tmp_path, capsys):
    Plan(own_metrics={"boom": MetricEntry("Boom", "", "", 1, True, (None, None), "")}).write(tmp_path)
    why = "failed: ValueError: 7 (boom.py, line 3)"
    write(tmp_path, scene="orbit", dataset="folder", scores={"boom": None}, missing={"boom": why})
    tables = build_tables(tmp_path)
    show_tables(tables)
    note = f"n/a: Boom (all rows): {why}"
    assert note in capsys.readouterr().out.splitlines() and note in write_report(tables).read_text(encoding="utf-8")


def test_hours_are_times_for_readers_and_numbers_on_disk(tmp_path):
    for seed in (0, 1):
        write(tmp_path, "tdg", "Truck", seed=seed, seconds={"train": 3600.0 + 120 * seed})
    tables = build_tables(tmp_path)
    cell = next(row for row in tables.grid.rows if row.heads[1:] == ("Truck", "TDg")).cells[-1]
    assert tables.grid.columns[-1] == "time ↓"
    assert cell.text == "1:01:00 ± 0:01:25" and cell.sort == pytest.approx(3660 / 3600)
    (published,) = tables.difference.query("method == 'tdg' and scene == 'Truck' and metric == 'train_hours'")[
        "published"
    ]
    assert cell.note == "+" + duration(3660 - 3600 * published)
    assert cell.title.startswith(f"published {duration(3600 * published)}: undecided")
    stored = pd.read_csv(tmp_path / "tables" / "main.csv", keep_default_na=False)
    hours = stored.query("method == 'tdg' and metric == 'train_hours' and scene == 'Truck'")
    assert hours["value"].tolist() == ["1.016667"]


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """MSMG at Parterre, as published, and at Truck, far off, with three seeds each; TDg at Truck with one."""
    experiment = tmp_path_factory.mktemp("published")
    for seed, psnr in enumerate((24.05, 24.06, 24.08)):
        write(experiment, "msmg", "Parterre", seed=seed, scores={"psnr": psnr})
        write(experiment, "msmg", "Truck", seed=seed, scores={"psnr": psnr})
    write(experiment, "tdg", "Truck", scores={"psnr": 24.0})
    return build_tables(experiment)


def row(tables, method, scene, metric="psnr"):
    found = tables.difference.query("method == @method and scene == @scene and metric == @metric")
    return next(found.itertuples())


def test_a_verdict_in_words(tables):
    note, details = difference_note(row(tables, "msmg", "Parterre"), "Parterre")
    assert note == "+0.00"
    interval = "90 % interval of our mean: 24.04 to 24.09, margin 0.2"
    assert details == f"published 24.06: reproduced; {interval}; other papers (perhaps of another method): 26.16"
    note, details = difference_note(row(tables, "msmg", "Truck"), "Truck")
    assert note == "-1.84" and details.startswith("published 25.90: worse; 90 % interval of our mean")


def test_nothing_is_said_where_there_is_nothing(tables):
    assert difference_note(None, "Truck") == ("", "") and difference_note(row(tables, "tdg", "Lion"), "Lion") == (
        "",
        "",
    )


def test_the_section(tables):
    found = published_section(tables)
    verdicts = {metric: rest for metric, *rest in found["verdicts"]}
    assert verdicts[measure_of("psnr").title] == ["0.2", "1 reproduced, 1 worse, 1 undecided (unknown for 1)"]
    assert measure_of("train_hours").title not in verdicts
    parterre = next(row for row in found["rows"] if row[1] == "Parterre")
    assert parterre[3:5] == ["tdg 24.06; thermosplat-2601 26.16", "2.10"]
    assert len(found["rows"]) == 8 and len(found["notes"]) == 1
    assert published_section(replace(tables, difference=None)) is None

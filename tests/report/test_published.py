"""What stands beside published numbers on the page."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tdgbench.report.published import beside, published_section
from tdgbench.tables.build import build_tables
from tdgbench.tables.measures import measure
from tests.helpers.records import write


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
    note, details = beside(row(tables, "msmg", "Parterre"), "Parterre")
    assert note == "+0.00"
    interval = "90 % interval of our mean: 24.04 to 24.09, margin 0.2"
    assert details == f"published 24.06: reproduced; {interval}; other papers: 26.16"
    note, details = beside(row(tables, "msmg", "Truck"), "Truck")
    assert note == "-1.84" and details.startswith("published 25.90: worse; 90 % interval of our mean")


def test_undecided_says_why(tables):
    _, details = beside(row(tables, "tdg", "Truck"), "Truck")
    assert details == "published 26.28: undecided, one seed has no spread; seeds needed: unknown"


def test_nothing_is_said_where_there_is_nothing(tables):
    assert beside(None, "Truck") == ("", "") and beside(row(tables, "tdg", "Lion"), "Lion") == ("", "")


def test_the_section(tables):
    found = published_section(tables)
    psnr = next(v for v in found["verdicts"] if v["metric"] == measure("psnr").title)
    assert psnr["margin"] == "0.2" and psnr["counts"] == "1 reproduced, 1 worse, 1 undecided (unknown for 1)"
    assert measure("hours").title not in [v["metric"] for v in found["verdicts"]]
    parterre = next(r for r in found["rows"] if r["head"][1] == "Parterre")
    assert parterre["cells"][0] == {"text": "tdg 24.06; thermosplat-2601 26.16", "spread": "2.10"}
    assert len(found["rows"]) == 8 and len(found["notes"]) == 1
    assert published_section(replace(tables, difference=None)) is None

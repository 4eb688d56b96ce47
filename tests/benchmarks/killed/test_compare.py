"""Differences and leftovers are found; times are no difference."""

from __future__ import annotations

import json
import shutil

import pytest

from benchmarks.killed.compare import compare
from tdgbench.report.report_page import write_report
from tdgbench.tables.build import build_tables


@pytest.fixture(scope="module")
def two(small_results, tmp_path_factory):
    """A folder with two copies of a finished cell, with tables and report."""
    both = tmp_path_factory.mktemp("two")
    for name in ("calm", "killed"):
        folder = both / name / small_results.name
        shutil.copytree(small_results, folder)
        for path in list((folder / "cells").rglob("record.json")):
            if "tdg/synthetic/turntable" not in path.as_posix():
                shutil.rmtree(path.parent)
        (folder / "experiment.json").write_text("{}")
        write_report(build_tables(folder))
    return both


@pytest.fixture
def pair(two, tmp_path):
    """Copies of both, to be changed."""
    shutil.copytree(two, tmp_path, dirs_exist_ok=True)
    return [next((tmp_path / name).iterdir()) for name in ("calm", "killed")]


def cell(folder):
    return sorted(path.parent for path in (folder / "cells").rglob("record.json"))[0]


def test_times_are_no_difference(pair):
    record = cell(pair[1]) / "record.json"
    content = json.loads(record.read_text())
    content["seconds"]["train"] += 7
    record.write_text(json.dumps(content))
    write_report(build_tables(pair[1]))
    assert compare(*pair) == []


@pytest.mark.parametrize("name", ["model.ply", "views.csv", "log.csv", "cameras.json"])
def test_other_bytes_are(pair, name):
    path = cell(pair[1]) / name
    path.write_bytes(path.read_bytes().replace(b"1", b"2"))
    assert any(name in problem for problem in compare(*pair))


def test_what_is_missing_and_leftovers_are(pair):
    (pair[1] / "tables" / "main.csv").unlink()
    (pair[1] / "checkpoints").mkdir(exist_ok=True)
    (pair[1] / "checkpoints" / "a.pt").touch()
    (cell(pair[1]).parent / ".seed0.part-1").mkdir()
    found = compare(*pair)
    assert any("main.csv" in problem for problem in found)
    assert len([problem for problem in found if "leftover" in problem]) == 2
    shutil.rmtree(cell(pair[1]))
    assert any("only in one" in problem for problem in compare(*pair))

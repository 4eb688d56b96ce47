"""`tdgbench new method NAME` writes what the page on methods shows, and that trains."""

from __future__ import annotations

import pytest

from tdgbench.cells.record import read_all
from tests.helpers.command import command_here, tdgbench, tdgbench_here
from tests.helpers.configs import QUICK
from tests.helpers.modules import forgotten
from tests.helpers.page import FILE, PAGES


def test_the_page_on_methods_shows_what_is_written(tmp_path):
    assert tdgbench(tmp_path, "new", "method", "gradient").returncode == 0  # other tests import such a module
    shown = dict(FILE.findall((PAGES / "method.md").read_text(encoding="utf-8")))
    assert {name: (tmp_path / name).read_text(encoding="utf-8") for name in shown} == shown


def test_a_written_method_trains(tmp_path, data_root):
    """Outside of the checkout: `--config-dir` finds its YAML, the working folder its module."""
    written = tdgbench_here(tmp_path, "new", "method", "my_method")
    assert written.stdout.startswith("wrote my_method.py and yaml/method/my_method.yaml; "), written.stderr
    words = ("--config-dir", "yaml", "method=my_method", "scene=turntable", f"data.root={data_root}", *QUICK)
    with forgotten(tmp_path):
        run = command_here(tmp_path, *words)
    assert run.returncode == 0 and "1 cell run" in run.stdout, run.stderr[-3000:]
    (record,) = read_all(tmp_path / "results" / "single")
    assert (record.method, record.variant, record.status, record.iterations) == ("my_method", "", "ok", 12)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("3dgs", "no name of a module"),
        ("MSMG", "no name"),
        ("tdg", "is a method of tdgbench"),
        ("random", "or a module"),
        ("class", "is a word of Python"),
    ],
)
def test_a_name_that_is_taken_is_one_line(tmp_path, name, why):
    run = tdgbench_here(tmp_path, "new", "method", name)
    assert run.returncode == 1 and why in run.stderr and run.stderr.count("\n") == 1 and not [*tmp_path.iterdir()]


def test_nothing_is_replaced(tmp_path):
    (tmp_path / "mine.py").write_text("mine")
    run = tdgbench_here(tmp_path, "new", "method", "mine")
    assert run.stderr == "tdgbench new: mine.py exists: choose another name, or remove it\n"
    assert (tmp_path / "mine.py").read_text() == "mine" and not (tmp_path / "yaml").exists()

"""Labels, order and comparisons come from the methods' YAML files."""

import pandas as pd
import pytest

from tdgbench.cells.plan import Plan, method_entries
from tdgbench.report.report_page import write_report
from tdgbench.resources import conf_folder
from tdgbench.tables import methods
from tdgbench.tables.build import build_tables
from tests.helpers.records import without_cells, write

MINE = "defaults: [tdg, _self_]\nname: mine\nlabel: Mine & Co\norder: 0\ncompared_with: msmg\n"


@pytest.fixture
def conf(tmp_path, monkeypatch):
    """The project's methods, and one more."""
    folder = tmp_path / "conf" / "method"
    folder.mkdir(parents=True)
    for path in (conf_folder() / "method").glob("*.yaml"):
        (folder / path.name).write_text(path.read_text())
    (folder / "mine.yaml").write_text(MINE)
    monkeypatch.setattr(methods, "conf_folder", lambda: folder.parent)
    return folder


def test_every_method_has_a_label():
    names = [path.stem for path in (conf_folder() / "method").glob("*.yaml")]
    assert all(methods.entry(name).label != name for name in names)
    assert methods.pairs()[0] == ("tdg", "msmg") == methods.paper_pair()
    assert {name for pair in methods.pairs() for name in pair} <= set(names)
    assert sorted(names, key=methods.rank)[:2] == ["msmg", "tdg"]


def test_labels_are_not_inherited(conf):
    (conf / "mine.yaml").write_text("defaults: [tdg, _self_]\nname: mine\n")
    assert methods.entry("mine") == ("mine", methods.LAST, None)
    for wrong in ("order: first", "label: ''"):  # a plan with it could not be read
        (conf / "mine.yaml").write_text(wrong)
        with pytest.raises(ValueError, match=f"{conf / 'mine.yaml'}: {wrong.split(':')[0]} "):
            method_entries(conf.parent)


def test_a_new_method_is_printed_and_compared(tmp_path, conf):
    for seed, method in enumerate(("tdg", "msmg", "mine", "unheard_of")):
        write(tmp_path / "made", method, scene="orbit", dataset="synthetic", scores={"psnr": 20.0 + seed})
    tables = build_tables(tmp_path / "made")
    assert list(dict.fromkeys(tables.main["method"])) == ["mine", "msmg", "tdg", "unheard_of"]
    assert r"{Mine \& Co} & \multicolumn{4}{c}{MSMG}" in tables.latex and r"{unheard\_of}" in tables.latex
    written = pd.read_csv(tmp_path / "made" / "tables" / "paired.csv").set_index(["method", "metric"])
    assert written.loc[("mine", "psnr"), ["baseline", "scenes", "undecided"]].tolist() == ["msmg", 1, 1]
    page = write_report(without_cells(tables)).read_text()
    assert "Mine &amp; Co" in page and ">TDg<" in page and ">unheard_of<" in page


def test_plan_methods_without_records_are_columns(tmp_path):
    write(tmp_path, scene="orbit", dataset="synthetic")
    Plan(methods=["tdg", "msmg"]).write(tmp_path)
    assert list(dict.fromkeys(build_tables(tmp_path).main["method"])) == ["msmg", "tdg"]

"""Every table says which numbers are of images in a palette."""

import pandas as pd
import pytest

from tdgbench.cells.plan import Plan
from tdgbench.scenes.scene import PALETTE
from tdgbench.tables.build import build_tables
from tdgbench.tables.palette import IN_SOME, WORDS, palette_notes
from tdgbench.tables.show import show_tables
from tests.helpers.records import published_as_records, write, write_ablation

DAGGER = r"$^\dagger$"
COLOURED = {"assumed": {"values": PALETTE}}
GRAY = {"assumed": {"values": "gray, 0 and 1 are 14 and 50 °C"}}


def stored(folder, name) -> pd.DataFrame:
    return pd.read_csv(folder / "tables" / f"{name}.csv", keep_default_na=False)


@pytest.fixture
def experiment(tmp_path):
    """The published table: RGBT-Scenes in a palette, by records of before and of now, ThermalMix in °C."""
    published_as_records(tmp_path)
    for path in tmp_path.rglob("record.json"):
        text = path.read_text()
        if '"dataset": "RGBT-Scenes"' in text:
            text = text.replace('"channels": 0', '"channels": 3')
            if '"scene": "Truck"' in text:
                text = text.replace('"assumed": {}', f'"assumed": {{"values": "{PALETTE}"}}')
        else:
            text = text.replace('"channels": 0', '"channels": 1')
        path.write_text(text)
    return tmp_path


def test_csv_says_it_of_every_number(experiment):
    tables = build_tables(experiment)
    for name, is_whole in (("main", True), ("difference", True), ("others", False)):
        table = stored(experiment, name)
        expected = table["dataset"].map({"RGBT-Scenes": WORDS, "ThermalMix": "", "": IN_SOME})
        assert list(table["image_values"]) == list(expected) and (set(expected) == {WORDS, "", IN_SOME}) == is_whole
    assert set(stored(experiment, "paired")["image_values"]) == {IN_SOME}
    assert palette_notes(tables.main) == [f"† {WORDS}; Average (Overall): in some scenes"]


def test_printed_tables_mark_scenes_and_averages_and_explain_the_mark_once(experiment, capsys):
    tables = build_tables(experiment)
    marked = [line.split(DAGGER)[0] for line in tables.latex.splitlines() if f"{DAGGER} & " in line]
    assert len(marked) == 9 + 2 and marked[4] == r"\qquad Truck" and marked[-1] == r"\textbf{Average (Overall)}"
    assert rf"\raggedright {DAGGER} {WORDS}; Average (Overall): in some scenes\par" in tables.latex
    show_tables(tables)
    shown = capsys.readouterr().out
    assert shown.count("†") == 11 + 1 and "│ Truck †" in shown and "│ Lion " in shown and f"\n† {WORDS};" in shown


def test_an_ablation_says_it(tmp_path, capsys):
    write_ablation(tmp_path)
    for path in tmp_path.rglob("record.json"):
        path.write_text(path.read_text().replace('"channels": 0', '"channels": 3'))
    Plan("ablation").write(tmp_path)
    tables = build_tables(tmp_path)
    for name in ("main", "difference"):
        assert set(stored(tmp_path, name)["image_values"]) == {WORDS}
    assert rf"TDg{DAGGER} & $\times$ & $\checkmark$ & 27.42 / 0.8899" in tables.latex
    assert rf"\raggedright {DAGGER} {WORDS}\par" in tables.latex
    show_tables(tables)
    assert f"\n† {WORDS}\n" in (shown := capsys.readouterr().out) and shown.count("†") == 5


def test_methods_of_other_images_are_told_apart(tmp_path):
    write(tmp_path, "tdg", "orbit", "synthetic", **COLOURED)
    write(tmp_path, "msmg", "orbit", "synthetic", **GRAY)
    tables = build_tables(tmp_path)
    of_methods = tables.main[tables.main["scene"] == "orbit"].groupby("method")["image_values"].unique().map(list)
    assert of_methods.to_dict() == {"tdg": [WORDS], "msmg": [""]}
    assert palette_notes(tables.main) == [f"† {WORDS} (TDg alone)"]


def test_without_a_palette_nothing_is_marked(tmp_path, capsys):
    write(tmp_path, scene="orbit", dataset="synthetic", **GRAY)
    show_tables(tables := build_tables(tmp_path))
    assert not tables.main["image_values"].any() and "†" not in capsys.readouterr().out and "dagger" not in tables.latex

"""Names of scenes and methods in tables: as they are, and no program takes them for commands."""

import contextlib
from dataclasses import replace

import pandas as pd
import pytest

from tdgbench.tables.build import Tables, build_tables
from tdgbench.tables.latex import escape
from tdgbench.tables.measures import AVERAGE
from tdgbench.tables.show import show_tables
from tdgbench.text import from_csv, one_line
from tests.helpers.names import NAMES
from tests.helpers.records import write

METHODS = ("[/red]", "=1+1", "$x^2$", "<script>alert(1)</script>")


@pytest.fixture(scope="module")
def tables(tmp_path_factory) -> Tables:
    """Every name once as a scene's and once as a method's, with an error that holds it."""
    experiment = tmp_path_factory.mktemp("names")
    for name in NAMES:
        with contextlib.suppress(FileExistsError):  # names that share a folder
            write(experiment, scene=name, dataset="synthetic", group=name)
        if name in METHODS:
            write(experiment, method=name, scene="orbit", dataset="@x", missing={"lpips": name}, scores={"lpips": None})
    return build_tables(experiment)


def test_csv_holds_every_name(tables):
    assert b"\r" not in (tables.folder / "main.csv").read_bytes().replace(b"a\rb", b"")
    stored = pd.read_csv(tables.folder / "main.csv", keep_default_na=False)
    for column in ("method", "dataset", "group", "scene", "reason"):
        assert list(stored[column].map(from_csv)) == list(tables.main[column].fillna("")), column
        assert not stored[column].str.startswith(("=", "+", "-", "@")).any()
    assert {"=1+1", "+1", "-1", "@x", "\n=1+1"} <= set(stored["scene"].map(from_csv))
    assert pd.to_numeric(stored.loc[stored["scene"] == "a$b", "value"], errors="coerce").notna().any()


def test_latex_has_one_row_per_scene(tables):
    lines = tables.latex.splitlines()
    scenes = [scene for scene in dict.fromkeys(tables.main["scene"]) if not scene.startswith(AVERAGE)]
    rows = [line for line in lines if line.startswith(r"\qquad ")]
    assert len(rows) == len(tables.main.loc[tables.main["scene"].isin(scenes), ["dataset", "scene"]].drop_duplicates())
    for scene in scenes:
        assert any(line.startswith(rf"\qquad {escape(scene)} & ") for line in rows), scene
    columns = 1 + 4 * tables.main["method"].nunique()
    assert all(line.replace(r"\&", "").count("&") == columns - 1 for line in rows)


def test_the_terminal_shows_every_name_and_obeys_none(tables, capsys):
    main = tables.main[tables.main["method"].isin(["tdg", "[/red]"])]
    show_tables(replace(tables, main=main))
    text = capsys.readouterr().out
    for scene in dict.fromkeys(main["scene"]):
        assert one_line(scene) in text, scene
    assert "\x1b" not in text and "\u202e" not in text and "[/red]" in text and "a\\x1b[2Jb" in text

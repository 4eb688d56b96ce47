"""Whatever is read before and beside it, a folder's own methods and metrics are printed as its plan says."""

import re
from pathlib import Path

import pandas as pd
import pytest

from tdgbench.cells.plan import MethodEntry, MetricEntry, Plan
from tdgbench.compare import compare_command
from tdgbench.experiments.sweep.finish import write_all
from tdgbench.packs import pack
from tdgbench.scoring.metric import FAILED
from tdgbench.site import site_pages
from tdgbench.tables.build import build_tables
from tdgbench.tables.columns import own_columns
from tdgbench.tables.grids import failed_metrics
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import write

BARE = re.compile(r"\b(mine_[ab]|shared|edges_[ab]|hiss)\b(?! on mine/)")  # but for names of cells


@pytest.fixture
def folders(tmp_path) -> list[Path]:
    """A and B, each with a method and a metric of its own; both have the method `shared` and the metric `hiss`."""
    for name in "AB":
        methods = {f"mine_{name.lower()}": MethodEntry(f"Mine {name}"), "shared": MethodEntry(f"Shared {name}")}
        metrics = {one: MetricEntry(f"{words} {name}", "", name, 1, True, (None, None), "")
                   for one, words in ((f"edges_{name.lower()}", "Edges"), ("hiss", "Hiss"))}  # fmt: skip
        Plan(own_methods=methods, own_metrics=metrics).write(tmp_path / name)
        for method in methods:
            for seed in range(3):
                write(tmp_path / name, method, "Shed", "mine", seed=seed, scores=dict.fromkeys(metrics, 7.0))
    return [tmp_path / "A", tmp_path / "B"]


def cells_of(page: HtmlPage) -> set[str]:
    return {cell for table in page.tables for row in table for cell in row}


def test_a_site_prints_each_pack_as_it_says(folders, tmp_path):
    site, packs = tmp_path / "site", [pack(one, one.with_suffix(".zip"), keep_paths=True)[0] for one in folders]
    assert site_pages.main([*map(str, packs), str(site)]) == 0
    pages = {path: HtmlPage(path.read_text()) for path in site.rglob("*.html")}
    for path, page in pages.items():
        below_the_heading = [path.stem] * (path.parent.name == "methods")
        assert [text for text in page.texts if BARE.search(text)] == below_the_heading, path
    assert {"Mine A", "Mine B", "Shared A", "Shared B"} <= cells_of(pages[site / "index.html"])
    of_packs = [cells_of(page) for path, page in pages.items() if path.parent.name == "packs"]
    assert all(any({f"Mine {a}", f"Hiss {a}, {a} ↑"} <= cells for cells in of_packs) for a in "AB")
    headings = {"mine_a": "Mine A ", "mine_b": "Mine B ", "shared": "Shared A, Shared B "}
    assert all(label in pages[site / f"methods/{name}.html"].texts for name, label in headings.items())


def test_a_comparison_prints_the_names_of_both(folders, tmp_path, capsys):
    assert compare_command.main([*map(str, folders), "--out", str(tmp_path)]) == 0
    assert {"Shared B", "Edges A, A", "Edges B, B", "Hiss B, B"} <= cells_of(
        HtmlPage((tmp_path / "compare.html").read_text())
    )
    assert "Shared B" in capsys.readouterr().out


def test_a_folder_s_names_end_with_it(folders, tmp_path, capsys):
    write(tmp_path / "plain", "shared", "Shed", "mine")
    for folder in (*folders, tmp_path / "plain"):
        write_all(folder)
        texts = [(folder / name).read_text() for name in ("report.html", "tables/main.tex", "tables/findings.txt")]
        is_own, text = folder in folders, " ".join([capsys.readouterr().out, *texts])
        assert bool(BARE.search(text)) != is_own
        found = {f"{word} {a}" for word in ("Mine", "Shared", "Edges", "Hiss") for a in "AB" if f"{word} {a}" in text}
        assert found == {f"{word} {folder.name}" for word in ("Mine", "Shared", "Edges", "Hiss") if is_own}
        assert ("hiss" in pd.read_csv(folder / "tables/main.csv")["metric"].to_list()) == is_own


def test_a_metric_that_fails_in_one_seed_is_shown(tmp_path):
    plan = Plan(own_metrics={"hiss": MetricEntry("Hiss", "", "", 1, True, (None, None), "")})
    plan.write(tmp_path)
    for seed in range(3):
        missing = {} if seed else {"hiss": f"{FAILED}boom"}
        write(tmp_path, seed=seed, scores={"hiss": 7.0 if seed else None}, missing=missing)
    main = build_tables(tmp_path).main
    with own_columns(plan):
        assert failed_metrics(main) == ["hiss"]

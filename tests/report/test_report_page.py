"""The report: whole in one file, and alive in a browser where there is one."""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest
from markupsafe import escape

from tdgbench.cells.plan import Plan
from tdgbench.cells.record import Failure
from tdgbench.report.report_page import write_report
from tdgbench.tables.build import build_tables
from tdgbench.terminal import printable
from tests.helpers.browser import CHROMIUM, opened
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import published_as_records, without_cells, write, write_ablation

ACT = """(() => {
  const input = document.querySelector(".slider input");
  input.value = 80;
  input.dispatchEvent(new Event("input"));
  const head = document.querySelectorAll("#scores th")[3];
  const column = () => {
    head.click();
    return [...document.querySelectorAll("#scores tbody tr")].map(r => r.cells[3].dataset.sort).filter(x => x);
  };
  return {
    clip: document.querySelector(".slider .over").style.clipPath, up: column(), down: column(),
    pictures: [...document.images].every(i => i.complete && i.naturalWidth > 0),
  };
})()"""


@pytest.fixture(scope="module")
def page(tmp_path_factory, small_results):
    """The report of three finished cells and a failed one."""
    experiment = shutil.copytree(small_results, tmp_path_factory.mktemp("page") / "single")
    return write_report(build_tables(experiment))


def test_the_depth_prior_is_named(page):
    text = page.read_text(encoding="utf-8")
    assert "Depth prior of TDg: synthetic, made from true depth, with the errors of a monocular network" in text


def test_everything_is_in_the_file(page):
    text = page.read_text()
    parsed = HtmlPage(text)
    assert parsed.links and all(link.startswith(("data:", "#")) for link in parsed.links)
    assert "url(http" not in text and "@import" not in text
    assert parsed.tags.count("section") == 2 and text.count('class="slider"') == 3
    for part in ("turntable", "msmg", "14 °C", "50 °C", "training views", "2 of 3 channels", "backend cuda cannot run"):
        assert part in text, part
    assert len(re.findall(r"<svg", text)) == 2
    assert "n/a: msmg on" not in text  # all of it can be read
    assert 'id="papers"' not in text  # nothing is published for these scenes


def test_differences_to_published_numbers(tmp_path):
    published_as_records(tmp_path)
    tables = without_cells(build_tables(tmp_path))
    text = write_report(tables).read_text()
    assert text.count('class="note undecided"') > 100 and "+0.00" in text and "No finished cells" in text
    assert text.count('id="papers"') == 1 and "tdg 24.06; thermosplat-2601 26.16" in text
    begin = text[text.index("</h1>") : text.index("<h2>")]
    assert re.findall("<li>(.*?)</li>", begin) == [str(escape(sentence)) for sentence in tables.findings]
    assert len(tables.findings) == 4 and 'id="doubts"' not in text


def test_an_ablation(tmp_path):
    write_ablation(tmp_path)
    Plan("ablation").write(tmp_path)
    tables = without_cells(build_tables(tmp_path))
    text = write_report(tables).read_text()
    assert "PSNR of the training views, dB ↑" in text and "random: somewhere" in text
    assert text.count('class="note undecided"') == 8 and "40.00" in text


def test_assumptions_and_doubts_are_on_the_page(tmp_path):
    stated = {"assumed": {"size": "160×120 px", "values": "palette"}, "doubts": ["view007: <b>far</b> away"]}
    write(tmp_path, "tdg", "orbit", "synthetic", **stated)
    write(tmp_path, "msmg", "orbit", "synthetic", **{**stated, "assumed": {"size": "640×480 px", "values": "palette"}})
    page = HtmlPage(text := write_report(build_tables(tmp_path)).read_text())
    assert {"160×120 px (TDg)", "640×480 px (MSMG)", "palette"} <= page.texts and text.count("<dt>values</dt>") == 1
    assert "doubts" in page.ids and text.index("view007") < text.index("<h2>Scores") and text.count("view007") == 1
    assert "synthetic/orbit: view007: <b>far</b> away" in page.texts
    scenes = [row[1] for table in page.tables if table[0][:2] == ["data set", "scene"] for row in table[1:]]
    assert set(scenes) == {"orbit †", "Average †"} and text.count("† palette, not temperature") == 1


HOSTILE = ("<script>alert(1)</script>", '"a" onload="x', "a\x1b[2Jb", "\u202eevil", "{{ 1 }}", "=1+1")


def test_names_are_text_on_the_page(tmp_path):
    plain, page = (HtmlPage(page_of(tmp_path / folder, names)) for folder, names in (("a", ["x"]), ("b", HOSTILE)))
    assert page.tags.count("script") == 1 and set(page.tags) == set(plain.tags) and page.attributes == plain.attributes
    for name in HOSTILE:
        assert printable(name) in page.texts and f"failed: {printable(name)}" in page.texts, name
    assert all(c.isprintable() or c in "\n\t" for text in page.texts for c in text)


def page_of(experiment, names) -> str:
    """The page of cells without files, finished and failed, whose scenes, methods and errors have these names."""
    for seed, name in enumerate(names, start=1):
        failure = Failure("train", f"failed: {name}", "")
        write(experiment, method=name, scene=name, dataset="synthetic", group=name, split="folder",
              assumed={name: name}, doubts=[name])  # fmt: skip
        write(experiment, scene="orbit", dataset="synthetic", seed=seed, status="failed", failure=failure)
    return write_report(build_tables(experiment)).read_text(encoding="utf-8")


def nothing(path: Path) -> None:
    shutil.rmtree(path) if path.is_dir() else path.unlink()


def fifo(path: Path) -> None:
    nothing(path)
    os.mkfifo(path)


def cut(path: Path) -> None:
    nothing(path)
    path.write_bytes(b"\x89PNG\xff")


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        *(("renders/view005.png", spoil) for spoil in (nothing, fifo, cut)),
        *(("record.json", spoil) for spoil in (fifo, cut)),
        ("targets/view005.png", cut),
        ("model.ply", fifo),
        ("cameras.json", cut),
        ("log.csv", cut),
        ("views.csv", nothing),
        ("renders", nothing),
        *(("determinacy/view005.png", spoil) for spoil in (nothing, cut)),
    ],
)
def test_what_cannot_be_read_is_na_on_the_page(small_results, tmp_path, name, spoil):
    experiment = Path(shutil.copytree(small_results, tmp_path / "single"))
    cell = experiment / "cells" / "msmg" / "synthetic" / "turntable" / "colmap" / "seed0"
    spoil(cell / name)
    text = write_report(build_tables(experiment)).read_text(encoding="utf-8")
    assert text.rstrip().endswith("</html>") and text.count('<section class="scene">') == 2 and "tdg" in text
    if name == "record.json":
        assert name in text
    elif name != "views.csv":
        (problem,) = set(re.findall("n/a: msmg on [^<]*", text))
        assert name.removesuffix(".png") in problem


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_it_lives_in_a_browser(page, tmp_path):
    with opened(page.as_uri(), tmp_path / "profile", 1280, 2400) as browser:
        browser.wait_for("!!document.querySelector('#scores') && document.readyState === 'complete'")
        assert browser.screenshot(page.with_name("report.png")).std() > 20
        result = browser.run(ACT)
        assert [event for event in browser.events if event["method"] == "Runtime.exceptionThrown"] == []
    assert result["pictures"] and "80%" in result["clip"]
    numbers = [float(x) for x in result["up"]]
    assert numbers == sorted(numbers) and [float(x) for x in result["down"]] == sorted(numbers, reverse=True)

"""The report: whole in one file, and alive in a browser where there is one."""

from __future__ import annotations

import base64
import io
import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from markupsafe import escape
from PIL import Image

from tdgbench.cells.plan import Command, Plan
from tdgbench.cells.record import Failure
from tdgbench.present.colour_scale import colour_scale
from tdgbench.present.colours import colours_of_levels, in_colour
from tdgbench.present.view_pictures import ERROR
from tdgbench.report.report_page import write_report
from tdgbench.report.run_facts import run_facts
from tdgbench.tables.build import build_tables
from tdgbench.tables.results import read_results
from tdgbench.terminal import printable
from tests.helpers.browser import CHROMIUM, opened
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import published_as_records, without_cells, write, write_ablation

ACT = """(() => {
  const head = document.querySelectorAll("#scores th")[3];
  const column = () => {
    head.click();
    return [...document.querySelectorAll("#scores tbody tr")].map(r => r.cells[3].dataset.sort).filter(x => x);
  };
  const numbers = {up: column(), down: column()};
  const view = [...document.querySelectorAll(".view")].find(v => v.querySelectorAll(".render").length > 1);
  const [left, right] = view.querySelectorAll("select");
  right.value = 2;
  right.dispatchEvent(new Event("change"));
  view.querySelector(".slider input").focus();
  return {
    ...numbers, choices: [...left.options].map(o => o.text),
    renders: [...view.querySelectorAll(".render")].map(i => i.src),
    right: view.querySelector(".slider .right").src, truth: view.querySelector(".truth").src,
    pictures: [...document.images].every(i => i.complete && i.naturalWidth > 0),
    narrow: document.documentElement.scrollWidth,
  };
})()"""
BOX = """(() => {
  const box = document.querySelectorAll(".view")[%d].querySelector("%s").getBoundingClientRect();
  scrollTo(0, scrollY + box.top);
  const {x, y, width, height} = document.querySelectorAll(".view")[%d].querySelector("%s").getBoundingClientRect();
  return [x, y, width, height].map(Math.round);
})()"""


@pytest.fixture(scope="module")
def page(tmp_path_factory, small_results):
    """The report of three finished cells and a failed one."""
    experiment = shutil.copytree(small_results, tmp_path_factory.mktemp("page") / "single")
    path = next((experiment / "cells" / "msmg").rglob("record.json"))
    record = json.loads(path.read_text())
    record["parts"]["rgb_curriculum"] = {
        "checks": [[50, 2, 20.5], [100, 1, 21]],
        "settled_at": 75,
        "reason": "it stalls",
    }
    path.write_text(json.dumps(record))
    return write_report(build_tables(experiment))


def test_everything_is_in_the_file(page):
    text = page.read_text()
    parsed = HtmlPage(text)
    assert text.count("MSMG, thermal + RGB") == 2  # curves of loss and of Gaussians
    assert text.count("PSNR of held-out") == 1 and ", RGB: settled at iteration 75, since it stalls.</p>" in text
    assert parsed.links and all(link.startswith(("data:", "#")) for link in parsed.links)
    assert "url(http" not in text and "@import" not in text and str(page.parent) not in text
    assert parsed.tags.count("section") == 2
    for part in (
        "turntable",
        "MSMG",
        "training views",
        "2 of 3 channels",
        "backend cuda cannot run",
        "synthetic, made from true depth, with made-up errors, smaller than those of a monocular network (TDg)",
    ):
        assert part in text, part
    assert "n/a: MSMG on" not in text  # all of it can be read
    assert 'id="papers"' not in text  # nothing is published for these scenes
    assert len(text) < 2e6 * 3 / 8  # the demo shows eight cells in at most 2 MB


def test_the_head_says_what_was_run(tmp_path):
    ran = Command("tdgbench -m method=tdg,msmg data.root=.../arco", "2026-01-02 03:04 UTC")
    Plan(commands=[ran]).write(tmp_path)
    place = {"scene": "orbit", "dataset": "synthetic", "backend": "cpu", "protocol": "1-ab", "convention": "3dgs"}
    machine = {
        "cpu": "Xeon",
        "cores": 2,
        "threads": 1,
        "gpu": None,
        "git": {"commit": "0123456789abcdef", "dirty": True},
    }
    for method, seed, iterations in (("tdg", 0, 900), ("tdg", 2, 1100), ("msmg", 0, 400)):
        budget = {"name": "demo" if method == "tdg" else "lean", "iterations": 1200 if method == "tdg" else 400}
        write(tmp_path, method, seed=seed, iterations=iterations, environment=machine, split="every_8th", **place,
              assumed={"size": "640×480 px, as the files have; resized to 160×120 px"}, views={"test": 3, "train": 9},
              config={"budget": budget, "metrics": {"lpips": {"net": "vgg"}}})  # fmt: skip
    results = read_results(tmp_path)
    facts = dict(run_facts(results.plan, [cell.record for cell in results.finished]))
    assert facts["command"] == ["tdgbench -m method=tdg,msmg data.root=.../arco (2026-01-02 03:04 UTC)"]
    assert set(facts["budget"]) == {
        "demo, at most 1200 iterations; ended after 900 to 1100 (TDg)",
        "lean, at most 400 iterations (MSMG)",
    }
    assert set(facts["seeds"]) == {"0, 2 (TDg)", "0 (MSMG)"} and facts["LPIPS network"] == ["vgg"]
    assert facts["machine"] == ["Xeon, 2 cores, 1 thread a cell; no GPU; backend cpu"]
    assert facts["version"] == ["tdgbench unknown (0123456 with changes)"]
    assert facts["image sizes"] == ["640×480 px, as the files have; resized to 160×120 px"]
    assert facts["protocol"] == ["1-ab, metrics as 3dgs"] and facts["views"][0].startswith(
        "3 test and 9 train; split every_8th"
    )
    page = HtmlPage(write_report(build_tables(tmp_path)).read_text())
    assert {text for texts in facts.values() for text in texts} <= page.texts


def test_differences_to_published_numbers(tmp_path):
    published_as_records(tmp_path)
    tables = without_cells(build_tables(tmp_path))
    text = write_report(tables).read_text()
    assert text.count('class="note undecided"') > 100 and "+0.00" in text and "No finished cells" in text
    assert text.count('id="papers"') == 1 and "tdg 24.06; thermosplat-2601 26.16" in text
    begin = text[text.index("</h1>") : text.index("<h2>")]
    assert re.findall("<li>(.*?)</li>", begin) == [str(escape(sentence)) for sentence in tables.findings]
    assert tables.findings and 'id="doubts"' not in text


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
    assert set(scenes) == {"orbit †"} and text.count("† palette, not temperature") == 1


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
        (problem,) = set(re.findall("n/a: MSMG on turntable, seed 0: [^<]*", text))
        assert name.removesuffix(".png") in problem


@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
def test_it_lives_in_a_browser(page, tmp_path):
    with opened(page.as_uri(), tmp_path / "profile", 400, 900) as browser:
        browser.wait_for("!!document.querySelector('#scores') && document.readyState === 'complete'")
        result = browser.run(ACT)
        for kind in ("rawKeyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight", windowsVirtualKeyCode=39)
        clip = browser.run("document.activeElement.parentElement.querySelector('.over').style.clipPath")
        nth = browser.run(
            "[...document.querySelectorAll('.view')].findIndex(v => v.querySelectorAll('.render').length > 1)"
        )
        drawn = {}
        for name in (".truth", ".choose .difference", ".panels ~ .strip ~ .strip .difference"):
            x, y, width, height = browser.run(BOX % (nth, name, nth, name))
            drawn[name] = browser.screenshot()[y : y + height, x : x + width].reshape(-1, 3).mean(axis=0)
        browser.run(f"document.querySelectorAll('.view')[{nth}].querySelector('.picture').click()")
        assert browser.run("document.querySelector('dialog').open && !!document.querySelector('dialog img').src")
        assert [event for event in browser.events if event["method"] == "Runtime.exceptionThrown"] == []
    numbers = [float(x) for x in result["up"]]
    assert numbers == sorted(numbers) and [float(x) for x in result["down"]] == sorted(numbers, reverse=True)
    assert result["pictures"] and "51%" in clip and result["narrow"] == 400
    assert result["choices"][0] == "ground truth" and len(result["choices"]) == 3
    assert result["right"] == result["renders"][1] != result["renders"][0]
    truth, render = (decoded(uri) for uri in (result["truth"], result["right"]))
    errors = [abs(decoded(uri) / 255 - truth / 255).ravel() for uri in result["renders"]]
    scale = colour_scale(truth, None, (14, 50), np.concatenate(errors))
    assert drawn[".truth"] == pytest.approx(in_colour(truth, scale.low, scale.high).mean(axis=(0, 1)), abs=4)
    difference = colours_of_levels(ERROR, 0, scale.error)[abs(render.astype(int) - truth)[..., 0]]
    for name in list(drawn)[1:]:
        assert drawn[name] == pytest.approx(difference.mean(axis=(0, 1)), abs=4), name


def decoded(uri: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))))[..., None]

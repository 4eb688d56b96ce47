"""`tdgbench site`: links resolve, numbers are the records', names are text, equal packs give equal bytes."""

from __future__ import annotations

import html
import re
import shlex
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from PIL import Image

from tdgbench.cells.folder import hashes_below
from tdgbench.cells.plan import MetricEntry, Plan
from tdgbench.cells.record import Failure, read_all
from tdgbench.packs import pack
from tdgbench.site.packed import SCORES
from tdgbench.site.site_pages import main
from tdgbench.tables.long_table import metric_value
from tdgbench.tables.measures import as_text
from tdgbench.tables.overrides import training_in_words
from tdgbench.tables.published import published_main
from tests.helpers.browser import CHROMIUM, opened
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import published_as_records, with_truth, write, write_record
from tests.helpers.records import record as record_of

MEGABYTE = 2**20
ODD = """<script>alert("1")</script> & 'it' #?%"""


def pages(site: Path) -> dict[Path, HtmlPage]:
    return {path: HtmlPage(path.read_text(encoding="utf-8")) for path in sorted(site.rglob("*.html"))}


def make(folder: Path, *packs: Path) -> Path:
    assert main([*map(str, packs), str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def packed(small_results, tmp_path_factory) -> Path:
    return pack(small_results, tmp_path_factory.mktemp("packs") / "small.zip", keep_paths=True)[0]


@pytest.fixture(scope="module")
def odd(tmp_path_factory) -> Path:
    """Cells whose scene, data set, method and note are markup."""
    folder = tmp_path_factory.mktemp("odd") / "odd"
    for scene in (ODD, "other"):
        stated = {"notes": [ODD], "assumed": {ODD: ODD, "values": f"palette {ODD}"}, "doubts": [ODD]}
        write(folder, f"mine {ODD}", scene, dataset=ODD, config={"method": {"method": {"a": ODD}}}, **stated)
    return pack(folder, folder.with_name("odd&.zip"), keep_paths=True)[0]


@pytest.fixture(scope="module")
def published(tmp_path_factory) -> Path:
    """The published table as records of three seeds."""
    folder = tmp_path_factory.mktemp("published") / "table1"
    for seed in range(3):
        published_as_records(folder, seed)
    with_truth(folder)
    return pack(folder)[0]


@pytest.fixture(scope="module")
def site(packed, odd, published, tmp_path_factory) -> Path:
    return make(tmp_path_factory.mktemp("sites") / "site", packed, odd, published)


def test_all_links_resolve(site):
    found = pages(site)
    assert len(found) > 20
    for path, page in found.items():
        for link in page.links:
            name, _, anchor = link.partition("#")
            if link.startswith("data:"):
                continue
            target = (path.parent / unquote(name)).resolve() if name else path
            assert target.is_file() and target.is_relative_to(site.resolve()), (path.name, link)
            assert not anchor or anchor in found[target].ids
    linked = {(p.parent / unquote(n.partition("#")[0])).resolve() for p, page in found.items() for n in page.links}
    assert {path.resolve() for path in site.rglob("*") if path.is_file()} <= linked


def rows_of_index(site: Path) -> list[list[str]]:
    """Rows of the leaderboards: rank, method, scene, a number of each of SCORES that is shown, seeds, …, pack."""
    index = HtmlPage((site / "index.html").read_text(encoding="utf-8"))
    return [row for table in index.tables if table[0][0] == "rank" for row in table[1:]]


def test_every_number_is_that_of_the_records(small_results, packed, tmp_path):
    records = [record for record in read_all(small_results) if record.failure is None]
    labels = {"tdg": "TDg", "msmg": "MSMG"}
    site = make(tmp_path / "site", packed)
    rows = {(row[1], row[2]): row[3:] for row in rows_of_index(site)}
    text = (site / "index.html").read_text()
    assert "Built-in scenes: no evidence on the paper." in text
    assert "With budget demo, lengths and rules of growth" in text
    assert "The depth prior of TDg is made from true depth." in text
    assert "n/a: temperature error, °C" in text and "synthetic (built into tdgbench)" in text
    for record in records:
        scene = {"orbit": "orbit †"}.get(record.scene, record.scene)  # in a palette
        method = {"tdg": "TDg prior made from true depth"}.get(record.method, labels[record.method])
        *numbers, seeds, views, iterations, size, ranges, name = rows.pop((method, scene))
        values = [metric_value(record, metric)[0] for metric in SCORES]
        expected = ["n/a" if np.isnan(v) else as_text(m, v) for m, v in zip(SCORES, values, strict=True)]
        assert all(map(str.startswith, numbers, expected)) and (seeds, views, name) == (
            "1",
            str(record.views["test"]),
            "small.zip",
        )
        assert re.fullmatch(r"[\d.]+ [\d.]+ to [\d.]+", numbers[0])  # with the interval
        assert iterations == str(record.setting("budget.iterations"))
        assert re.fullmatch(r"\d+×\d+", size) and (ranges == "n/a") == (record.temperature_range is None)
    ((_, scene), numbers), *others = rows.items()  # TDg's failed cell is of a third scene
    assert scene == "mean of 2 scenes †" and numbers[0] == "n/a" and not others


def test_a_board_states_the_settings_of_its_protocol(tmp_path):
    for border, method in (("zero", "tdg"), ("valid", "msmg")):
        write(tmp_path / "two", method, "Truck", config={"metrics": {"ssim_border": border}}, protocol=f"1-{border}")
    folder = make(tmp_path / "site", pack(tmp_path / "two", tmp_path / "two.zip", keep_paths=True)[0])
    _, first, second = (folder / "index.html").read_text().split("<dt>metrics.ssim_border</dt>")
    assert first.startswith("<dd>&#34;valid&#34;</dd>") and "what decides these scores" in first  # of the other one
    assert second.startswith("<dd>&#34;zero&#34;</dd>")


def test_ranks_are_across_packs_and_of_like_trainings(tmp_path):
    """One seed has no rank; another budget has a table; equal cells count once, also with a metric of one's own."""
    cells = (("a", "tdg", (30.0, 30.2, 30.1), {}), ("b", "msmg", (25.0, 25.1, 25.3), {}), ("c", "3dgs", (40.0,), {}),
             ("d", "msmg", (20.0, 20.1), {"iterations": 9}), ("f", "msmg", (20.0,), {"iterations": 9}),
             ("e", "tdg", (30.0, 30.2, 30.1), {}))  # fmt: skip
    packs = []
    for name, method, psnr, budget in cells:
        for seed, value in enumerate(psnr):
            options, own = {"budget": {"name": "demo", **budget}}, {"edges": 7.0 + seed} if name in "be" else {}
            hashes = {"model.ply": f"{ord(method[0]) % 16:x}{seed}" * 32, "views.csv": f"{name}{seed}" * 32}
            fields = {"scores": {"psnr": value, **own}, "config": options, "hashes": hashes}
            fields["variant"] = "budget.iterations=9,lr=2" if name == "f" else ""
            if budget:
                skip = {"name": "plateau", "allowed": True, "taken": False, "reason": "", "saved": ""}
                fields |= {"iterations": 9, "skips": [skip]}
            write(tmp_path / name, method, "Shed", "mine", seed=seed, **fields)
        entries = {"edges": MetricEntry("sharpness", "of edges", "dB", 1, True, (None, None), "")} if own else {}
        with_truth(tmp_path / name)
        Plan(own_metrics=entries).write(tmp_path / name)
        packs.append(pack(tmp_path / name, tmp_path / f"{name}.zip", keep_paths=True)[0])
    folder = make(tmp_path / "site", *packs, "--title", "Sheds & more")
    index = (folder / "index.html").read_text()
    assert "<title>Sheds &amp; more</title>" in index
    assert [(row[0], *row[1:4:2], row[-1]) for row in rows_of_index(folder)] == [
        ("1", "TDg", "30.10 ± 0.10", "a.zip"), ("1", "TDg", "30.10 ± 0.10", "e.zip same cells as a.zip, ranked once"),
        ("2", "MSMG", "25.13 ± 0.15", "b.zip"), ("–", "3DGS", "40.00", "c.zip"), ("–", "MSMG", "20.05 ± 0.07", "d.zip"),
        ("–", "MSMG [lr=2]", "20.00", "f.zip its models and renders equal some of d.zip"),
    ]  # fmt: skip
    assert "budget demo, protocol" in index and "budget demo with iterations=9, protocol" in index
    assert re.findall(r"<b>(\d\d\.\d\d) ±", index) == ["30.10", "30.10"]
    assert sorted(re.findall(r"<text[^>]*>([^\d\W]\w+|3DGS)</text>", index)) == ["3DGS", "MSMG", "TDg"]
    assert [row[8] for row in rows_of_index(folder)] == ["n/a", "8.0 ± 1.0", "8.0 ± 1.0", "n/a", "2", "1"]
    assert index.count("not at a plateau") == 1 and "n/a: temperature error" not in index  # a column without numbers
    of_scene = (folder / "scenes" / "mine" / "Shed.html").read_text()
    assert 'MSMG</a><span class="soft">, 9 iterations</span>' in of_scene
    of_pack = next(page for page in (folder / "packs").glob("*.html") if "<h1>b.zip" in page.read_text()).read_text()
    assert "sharpness, dB ↑ *" in index and "sharpness, dB ↑: of edges." in index and "sharpness" in of_pack


def test_budgets_in_words_take_nothing_from_a_record_but_values(monkeypatch):
    monkeypatch.setenv("SECRET", "10000")
    method = {"paper_iterations": "${oc.decode:${oc.env:SECRET}}", "gradient": "signed"}
    stated = record_of(config={"budget": {"name": "paper", "iterations": 10000, "gaussians": None}, "method": method})
    assert training_in_words(stated) == "budget paper with iterations=10000"
    stated.config["method"]["paper_iterations"] = 10000
    assert training_in_words(stated) == "budget paper"
    of_base = record_of(config={"budget": {"name": "lean", "density": {"grad_threshold": 0.001}}})
    assert training_in_words(of_base) == "budget lean with density.grad_threshold=0.001"


def test_rows_of_other_images_are_not_compared(tmp_path):
    packs = []
    for name, data in (("a", "1f-9"), ("b", "1f"), ("c", "2e")):  # behind the hyphen: files of a depth prior
        of_version = {"code": name.replace("b", "a"), "environment": {"packages": {"tdgbench": name}},
                      "config": {"skip": {"gray": True} if name != "c" else {"otherwise": False}},
                      "prior": {"made_from": "points"}}  # fmt: skip
        write(tmp_path / name, "tdg" if name == "a" else "msmg", "Truck", data=data, **of_version)
        with_truth(tmp_path / name)
        packs.append(pack(tmp_path / name, tmp_path / f"{name}.zip", keep_paths=True)[0])
    assert "No ranks" not in (make(tmp_path / "same", *packs[:2]) / "index.html").read_text()
    index = (make(tmp_path / "mixed", *packs) / "index.html").read_text()
    assert "sparse points (COLMAP mostly finds them in RGB images)" in index
    differ = "scene&#39;s files; tdgbench: a or c; skip: default or none (all off)."
    assert f"<b>No ranks on Truck</b>: the rows of all packs differ in {differ}" in index


def test_checkpoints_chosen_by_test_views_have_no_rank(tmp_path):
    folder = tmp_path / "chosen"
    for method, psnr, rule in (("ours", 30.0, "best_test_view"), ("theirs", 29.0, "last"), ("others", 28.0, "last")):
        made = {"files": "0" * 8, "summary": "made elsewhere", "checkpoint_rule": rule}
        for seed in range(3):
            write(folder, method, "yard", "folder", seed=seed, scores={"psnr": psnr + seed / 100}, made_elsewhere=made)
    with_truth(folder)
    site = make(tmp_path / "site", pack(folder)[0])
    assert {row[1]: row[0] for row in rows_of_index(site)} == {"ours": "–", "theirs": "1", "others": "2"}
    assert "ours: its checkpoint was chosen by test views" in (site / "index.html").read_text()


def test_changed_options_stand_on_the_board(tmp_path):
    options = {"method": {"method": {"lambda_depth": 0.0}}}
    write(tmp_path / "changed", "tdg", "Truck", config=options)
    folder = make(tmp_path / "site", pack(tmp_path / "changed", tmp_path / "changed.zip", keep_paths=True)[0])
    said = "changed.zip: not as its file says: TDg: method.method.lambda_depth=0.0."
    for page in ("index.html", "methods/tdg.html"):
        assert said in (folder / page).read_text()


def test_a_method_with_a_failed_seed_is_shown_with_the_reason(tmp_path):
    for method in ("tdg", "3dgs"):
        for seed in range(3):
            write(tmp_path / "a", method, "Shed", "mine", seed=seed, scores={"psnr": 30.0 + seed / 10})
    with_truth(tmp_path / "a")
    failure = Failure("train", "OutOfMemoryError: no", "")
    write(tmp_path / "a", "3dgs", "Shed", "mine", seed=3, status="failed", failure=failure)
    folder = make(tmp_path / "site", pack(tmp_path / "a", tmp_path / "a.zip", keep_paths=True)[0])
    rows = {row[1]: row for row in rows_of_index(folder)}
    assert rows["3DGS"][0] == "–" and rows["3DGS"][3] == "n/a" and rows["TDg"][3].startswith("30.10")
    assert "in 1 of 4 seeds failed" in (folder / "index.html").read_text() and (folder / "methods/3dgs.html").is_file()


def test_rows_without_ground_truth_are_not_ranked(tmp_path):
    """What no file shows may be of other images."""
    packs = []
    for method in ("tdg", "msmg"):
        for seed in range(3):
            write(tmp_path / method, method, "Shed", "mine", seed=seed, scores={"psnr": 30.0 + seed / 10})
        packs.append(pack(tmp_path / method, tmp_path / f"{method}.zip", keep_paths=True)[0])
    index = (make(tmp_path / "site", *packs) / "index.html").read_text()
    assert "<b>No ranks on Shed</b>: the rows of all packs differ in ground truth" in index


def test_a_method_s_name_may_be_long(tmp_path):
    write(tmp_path / "a", "m" * 300, "Shed", "mine")
    make(tmp_path / "site", pack(tmp_path / "a", tmp_path / "a.zip", keep_paths=True)[0])


def test_published_numbers_and_verdicts_stand_beside(site):
    rows = [row for row in rows_of_index(site) if row[1:3] == ["TDg", "Truck"]]
    table = published_main().set_index(["method", "scene", "metric"])["value"]
    text = as_text("psnr", float(table["tdg", "Truck", "psnr"]))
    assert [row[3] for row in rows] == [f"{text} ± 0.00 published {text}, reproduced"]
    assert (rows[0][0], rows[0][8], rows[0][10]) == ("1", "3", "0")  # of two methods with equal seeds
    of_thermalmix = published_main().query("method == 'tdg' and dataset == 'ThermalMix' and metric == 'psnr'")
    mean = of_thermalmix[~of_thermalmix["scene"].str.contains("Average")]["value"].mean()
    means = [row[3] for row in rows_of_index(site) if row[1] == "TDg" and row[2].startswith("mean of")]
    assert f"{as_text('psnr', mean)} ± 0.00" in [" ".join(text.split()[:3]) for text in means]


def test_names_are_text(site):
    found = pages(site)
    assert all(page.tags.count("script") == 1 for page in found.values())
    texts = [cell for page in found.values() for table in page.tables for row in table for cell in row]
    assert any(ODD in text for text in texts)
    stated = {ODD, f"palette {ODD}", f"{ODD}/other: {ODD}"}
    assert all(stated <= page.texts for path, page in found.items() if path.stem == "other")
    assert not [path for path in found if "<script>alert" in path.read_text(encoding="utf-8")]


def test_equal_packs_give_equal_bytes(packed, odd, tmp_path):
    once, again = make(tmp_path / "once", packed, odd), make(tmp_path / "again", odd, packed, packed)
    files = {path.relative_to(once): path.read_bytes() for path in once.rglob("*") if path.is_file()}
    assert {path.relative_to(again): path.read_bytes() for path in again.rglob("*") if path.is_file()} == files


def weight(path: Path, page: HtmlPage) -> int:
    files = {(path.parent / unquote(link.partition("#")[0])).resolve() for link in page.links}
    return path.stat().st_size + sum(f.stat().st_size for f in files if f.suffix in (".png", ".css", ".js"))


def test_a_page_of_many_methods_has_at_most_a_megabyte(tmp_path):
    rng = np.random.default_rng(0)
    for index in range(4):
        folder = write(tmp_path / "many", f"method{index}", scene="noise", dataset="mine", config={"a": index})
        for sub in ("renders", "targets"):
            (folder / sub).mkdir()
            Image.fromarray(rng.integers(0, 255, (480, 640), np.uint8)).save(folder / sub / "view.png")
        record = next(r for r in read_all(tmp_path / "many") if r.method == f"method{index}")
        record.hashes = hashes_below(folder)
        record.write(folder)
    made = make(tmp_path / "site", pack(tmp_path / "many")[0])
    weights = {path.name: weight(path, page) for path, page in pages(made).items()}
    assert MEGABYTE / 10 < weights["noise.html"] < MEGABYTE and max(weights.values()) < MEGABYTE


def test_pictures_that_cannot_be_read_are_na(site):
    page = next(path for path in site.rglob("Truck.html"))
    assert "n/a: " in page.read_text(encoding="utf-8")


def test_all_cells_and_the_checklist_are_on_the_page_of_a_pack(site, small_results):
    text = next(p for p in (site / "packs").glob("*.html") if "small.zip" in p.read_text()).read_text(encoding="utf-8")
    (cells,) = [table[1:] for table in HtmlPage(text).tables if table[0][:3] == ["method", "scene", "seed"]]
    assert len(cells) == len(read_all(small_results)) and "failed in load" in " ".join(row[-1] for row in cells)
    assert "2 of 3 seeds of each cell" in text and "tdgbench verify small.zip" in text


def test_the_page_of_a_method_has_its_reading_and_claims(site):
    text = (site / "methods" / "tdg.html").read_text(encoding="utf-8")
    assert "smoothness_reading: written" in text and "PSNR of TDg is 0.01 % better" in text
    assert "of 2" in text and "tied with MSMG" in text
    assert "<summary>fails</summary>27.18 → 27.42 is +0.883 %" in text


def test_refusals(packed, small_results, tmp_path, capsys):
    (tmp_path / "there").mkdir()
    for words, why in (
        ([packed, tmp_path / "there"], "is there already"),
        ([small_results, tmp_path / "x"], "is no file; make one of a results folder with tdgbench pack"),
        ([tmp_path / "none.zip", tmp_path / "x"], "is no file"),
    ):
        assert main([str(word) for word in words]) == 1
        assert why in capsys.readouterr().err and not (tmp_path / "x").exists()
    folder = write_record(tmp_path / "failed", record_of(), {"seconds": {"train": 1.0}}).parents[5]
    (folder / "experiment.json").write_text("[]")
    path, _ = pack(folder)
    assert main([str(path), str(tmp_path / "x")]) == 1 and f"{path}/experiment.json" in capsys.readouterr().err
    path.write_bytes(path.read_bytes()[:-9])
    assert main([str(path), str(tmp_path / "x")]) == 1 and "is no pack" in capsys.readouterr().err


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_in_a_browser_from_disk(site, tmp_path):
    pytest.importorskip("websockets")
    shown = "[...document.querySelectorAll('table.board tbody tr')].filter(row => !row.hidden).length"
    with opened((site / "index.html").as_uri(), tmp_path) as page:
        page.wait_for("document.readyState === 'complete' && !!document.querySelector('th[tabindex]')")
        whole = page.run(shown)
        page.run("search.value = 'truck'; search.dispatchEvent(new Event('input'))")
        assert page.run(shown) == 2 < whole and page.run("count.textContent").startswith("2 of ")
        page.run("search.value = ''; averages.click()")
        assert page.run(shown) < whole / 2
        page.run("document.querySelector('table.board th:nth-child(3)').focus()")
        for kind in ("keyDown", "keyUp"):
            page.call(
                "Input.dispatchKeyEvent", type=kind, key="Enter", code="Enter", windowsVirtualKeyCode=13, text="\r"
            )
        assert page.run("document.activeElement.getAttribute('aria-sort')") == "ascending"
        scene = next(path for path in (site / "scenes" / "synthetic").glob("*.html"))
        page.call("Page.navigate", url=scene.as_uri())
        page.wait_for("!!document.querySelector('.slider .over')?.style.clipPath")
        page.run("document.querySelector('.slider input').focus()")
        before = page.run("document.querySelector('.slider .over').style.clipPath")
        for kind in ("keyDown", "keyUp"):
            page.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight", windowsVirtualKeyCode=39)
        assert page.run("document.querySelector('.slider .over').style.clipPath") != before
        page.call("Emulation.setDeviceMetricsOverride", width=400, height=800, deviceScaleFactor=1, mobile=False)
        assert page.run("document.documentElement.scrollWidth") <= 400


def test_commands_are_quoted(small_results, tmp_path):
    """They are pasted into a shell, and a pack may have any name on a disk."""
    path = tmp_path / "-a; $(touch x) `y` 'z'.zip"
    pack(small_results, path, keep_paths=True)
    folder = make(tmp_path / "site", path)
    (page,) = (folder / "packs").glob("*.html")
    text = html.unescape(page.read_text()).split('tabindex="0">')[1].split("</pre>")[0]
    words = [shlex.split(line) for line in text.splitlines()]
    assert words[0] == ["tdgbench", "verify", f"./{path.name}"] and words[1][2] == f"./{path.name}"
    assert words[2] == ["tdgbench", "unpack", f"./{path.name}", f"results/{small_results.name}"]


def test_absurd_scores_have_a_site(tmp_path):
    for method, value in (("tdg", 20.0), ("msmg", -1e12)):
        write(tmp_path / "a", method, "Truck", scores={"psnr": value}, seconds={"train": 9.0})
    site = make(tmp_path / "site", pack(tmp_path / "a", tmp_path / "a.zip", keep_paths=True)[0])
    assert (site / "index.html").stat().st_size < MEGABYTE


@pytest.mark.parametrize(("score", "label", "more"), [("psnr", "PSNR", 0.3), ("ssim", "SSIM", 0.05)])
def test_equal_renders_with_another_score_have_no_rank(tmp_path, score, label, more):
    packs = []
    for name, gain in (("a", 0.0), ("b", more)):
        for method, psnr in (("tdg", 30.0), ("msmg", 25.0)):
            for seed in range(3):
                hashes = {"model.ply": f"{ord(method[0]) % 16:x}{seed}" * 32}
                scores = {"psnr": psnr + seed / 10, "ssim": 0.9}
                scores[score] += gain * (method == "tdg")
                write(tmp_path / name, method, "Shed", "mine", seed=seed, scores=scores, hashes=hashes)
        Plan().write(tmp_path / name)
        packs.append(pack(tmp_path / name, tmp_path / f"{name}.zip", keep_paths=True)[0])
    folder = make(tmp_path / "site", *packs)
    rows = [(row[0], row[1], row[-1].split()[0]) for row in rows_of_index(folder)]
    assert sorted(rows) == [  # nor have the others of the scene
        ("–", "MSMG", "a.zip"),
        ("–", "MSMG", "b.zip"),
        ("–", "TDg", "a.zip"),
        ("–", "TDg", "b.zip"),
    ]
    assert (folder / "index.html").read_text().count(
        f"<b>No ranks on Shed</b>: equal renders of TDg have unlike {label}, so a record was changed: verify the packs"
    ) == 1

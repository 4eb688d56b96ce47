"""`tdgbench compare A B`: pairs of cells, and verdicts on their differences."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tdgbench.cells.record import Failure, read_record
from tdgbench.compare import comparison_page
from tdgbench.compare.causes import find_causes
from tdgbench.compare.compare_command import main
from tests.helpers.compared import pairs_of, rows_of, two_experiments
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import write


@pytest.mark.parametrize(
    ("psnr_b", "verdict"),
    [
        ([20.0, 21.0, 22.0], "identical"), ([20.01, 20.99, 22.01], "equivalent"), ([21.0, 22.1, 23.0], "better"),
        ([19.0, 19.9, 21.0], "worse"), ([20.0, 22.0, 22.0], "undecided"),
    ],
)  # fmt: skip
def test_verdicts_are_of_the_differences_of_equal_seeds(tmp_path, psnr_b, verdict):
    row = rows_of(*two_experiments(tmp_path, [20.0, 21.0, 22.0], psnr_b)).loc["psnr"]
    assert row["verdict"] == verdict
    assert row["difference"] == pytest.approx(np.mean(psnr_b) - 21.0)
    assert (row["ci90_low"] <= row["difference"] <= row["ci90_high"]) and row["seeds"] == 3


def test_the_spread_of_a_repeat_is_not_that_of_seeds(tmp_path):
    rng = np.random.default_rng(0)
    seeds = rng.normal(20, 1, 400)
    a, b = two_experiments(tmp_path, *(list(seeds + rng.normal(0, 0.1, 400)) for _ in range(2)))
    row = rows_of(a, b).loc["psnr"]
    assert row["repeat_std"] == pytest.approx(0.1, rel=0.1)
    assert row["seed_std"] == pytest.approx(1.0, rel=0.1)
    a, b = two_experiments(tmp_path / "longer", [20.0, 21.0], [20.1, 21.0], iterations=9)
    assert np.isnan(rows_of(a, b).loc["psnr", "repeat_std"])


@pytest.mark.parametrize(
    ("psnr_b", "said"),
    [
        ([19.0], "PSNR, B against A: undecided; B − A -1.00 dB, by one seed: it decides nothing"),
        ([20.1, 20.908], "PSNR, B against A: undecided; B − A within ±0.01 dB, 90 % interval over seeds -0.602 to "
                         "+0.610, which contains zero"),
        ([22.0, 23.1], "PSNR, B against A: better; B − A +2.05 dB, 90 % interval over seeds +1.73 to +2.37"),
    ],
)  # fmt: skip
def test_a_finding_is_no_stronger_than_its_seeds(tmp_path, capsys, psnr_b, said):
    a, b = two_experiments(tmp_path, [20.0, 21.0], psnr_b)
    main([str(a), str(b)])
    assert f"found: {said}\n" in capsys.readouterr().out


def test_cells_of_one_experiment_alone_are_named(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0, 21.0, 25.0], [20.0])
    write(b, scene="Lion")
    assert main([str(a), str(b)]) == 0
    out = capsys.readouterr().out
    assert "means are over seed 0, which both have; A has seeds 1, 2 as well, which its tables average" in out
    assert (
        "finished in A alone: tdg on RGBT-Scenes/Truck, colmap, seed 1, tdg on RGBT-Scenes/Truck, colmap, seed 2\n"
        in out
    )
    assert "finished in B alone: tdg on RGBT-Scenes/Lion" in out
    assert "all scores that are compared are identical, in 1 cell\n" in out
    for folder, psnr in ((a, 30.0), (b, 31.0)):
        write(folder, scene="Hotel", train_scores={"psnr": psnr})
    main([str(a), str(b)])
    assert "all scores that are compared are identical" not in capsys.readouterr().out


def test_a_seed_that_failed_on_one_side_is_named(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0, 21.0, 25.0], [20.0, 21.0])
    failure = Failure("train", "ValueError: the loss is not finite", "")
    write(b, seed=2, status="failed", failure=failure, scores={})
    main([str(a), str(b), "--out", str(tmp_path / "out")])
    said = (
        "failed in B, not in A: tdg on RGBT-Scenes/Truck, colmap, seed 2 (failed in train: ValueError: the loss is not "
        "finite); means leave them out"
    )
    assert f"found: {said}\n" in capsys.readouterr().out and said in (tmp_path / "out" / "compare.html").read_text()
    main([str(b), str(a)])
    assert "failed in A, not in B: tdg on RGBT-Scenes/Truck, colmap, seed 2" in capsys.readouterr().out


@pytest.mark.parametrize(("where", "said"), [("b", "in B, not in A"), ("ab", "in A and B")])
def test_a_seed_that_failed_and_has_no_partner_is_named(tmp_path, capsys, where, said):
    a, b = two_experiments(tmp_path, [20.0], [20.0])
    failure = Failure("train", "ValueError: no", "")
    for name in where:
        write({"a": a, "b": b}[name], seed=1, status="failed", failure=failure, scores={})
    main([str(a), str(b)])
    assert f"failed {said}: tdg on RGBT-Scenes/Truck, colmap, seed 1 (failed in train" in capsys.readouterr().out


def test_where_rules_ended_trainings_is_an_outcome(tmp_path, capsys):
    config = {"budget": {"name": "lean", "iterations": 900}}
    a, b = tmp_path / "a", tmp_path / "b"
    for folder, iterations in ((a, 300), (b, 400)):
        write(folder, scores={"psnr": 20.0}, config=config, iterations=iterations)
        write(folder, "3dgs", scores={"psnr": 20.0}, config=config, iterations=900)
    assert not find_causes(pairs_of(a, b))
    main([str(a), str(b)])
    said = "rules ended trainings after 300 of at most 900 in A, 400 of at most 900 in B, iterations, in 1 of 2 cells"
    assert said in capsys.readouterr().out


def test_renders_whose_checkpoint_test_views_chose_are_named(tmp_path, capsys):
    made = {"files": "1", "summary": "elsewhere", "checkpoint_rule": "last"}
    a, b = tmp_path / "a", tmp_path / "b"
    write(a, scores={"psnr": 20.0}, made_elsewhere=made)
    write(b, scores={"psnr": 21.0}, made_elsewhere={**made, "checkpoint_rule": "best_test_view"})
    main([str(a), str(b)])
    out = capsys.readouterr().out
    assert "found: in B: selected: TDg: its checkpoint was chosen by test views" in out and "in A: selected" not in out
    assert "training: made elsewhere.checkpoint_rule: last → best_test_view" in out


def test_rows_name_initial_points_and_variants_that_are_not_usual(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [], [])
    for folder in (a, b):
        write(folder, scores={"psnr": 20.0}, init="random", variant="budget.sh_degree=0")
    main([str(a), str(b)])
    out = capsys.readouterr().out
    assert "random" in out and "budget.sh_degree=0" in out


def test_memory_is_not_compared_and_an_estimated_camera_is_said(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0], [20.0], config={"thermal_camera": {"estimate": True}}, peak_rss_mb=900)
    assert rows_of(a, b).loc["memory_mb", "verdict"] == "not compared"
    main([str(a), str(b)])
    out = capsys.readouterr().out
    assert "found: in B, renders are scored as the estimated thermal camera shows them" in out and "in A, " not in out


@pytest.mark.parametrize(
    ("extra", "said"),
    [
        (
            {"iterations": 9, "environment": {"threads": 2}},
            "times do not compare: iterations 0 → 9, threads not recorded → 2",
        ),
        (
            {"code": "new", "environment": {"cells_at_once": 2}},
            "times may differ because of the machine's settings or of the code: cells_at_once not recorded → 2",
        ),
    ],
)
def test_times_of_unlike_trainings_do_not_compare(tmp_path, capsys, extra, said):
    main([str(folder) for folder in two_experiments(tmp_path, [20.0], [20.0], **extra)])
    out = capsys.readouterr().out
    assert f"found: {said}" in out
    trained = "code" if "code" in extra else "iterations 0 → 9"
    (changed,) = extra["environment"]
    assert f"found: what differs: training ({trained}), machine ({changed} not recorded → 2)\n" in out


def test_times_of_a_busy_machine_or_of_unlike_trainings_have_no_difference(tmp_path):
    for name, extra in (("busy", {"backend": "cpu", "train_processor_seconds": 90.0}),
                        ("unlike", {"iterations": 9, "environment": {"threads": 2}})):  # fmt: skip
        row = rows_of(*two_experiments(tmp_path / name, [20.0, 20.1], [20.0, 20.1], **extra)).loc["train_hours"]
        assert row["verdict"] == "not compared" and np.isnan(row["difference"])
        assert row["reason"] == (
            "times of a busy machine" if name == "busy" else "iterations 0 → 9, threads not recorded → 2"
        )


def test_two_protocols_are_refused_and_said(tmp_path, capsys):
    weights = {"metrics": {"lpips": {"weights": "/home/ada/vgg.npz"}}}
    a, b = two_experiments(tmp_path, [20.0], [20.0], split="every_8th", config=weights)
    assert main([str(a), str(b), "--out", str(tmp_path / "out")]) == 1
    assert "found: no score is compared: two protocols (split: '' → every_8th)\n" in capsys.readouterr().out
    table = pd.read_csv(tmp_path / "out" / "compare.csv")
    assert set(table.loc[table["margin"].notna(), "verdict"]) == {"not compared"}
    page = (tmp_path / "out" / "compare.html").read_text()
    assert (
        "metrics.lpips.weights: not recorded → .../vgg.npz" in page and "/ada" not in page and str(tmp_path) not in page
    )
    assert "<h1>A: .../a, B: .../b</h1>" in page


@pytest.mark.parametrize(
    ("extra", "said", "status"),
    [
        ({"config": {"budget": {"name": "paper"}, "metrics": {"lpips": {"net": "alex"}}}},
         "two protocols (metrics.lpips.net: not recorded → alex)", 1),
        ({"scores": {"lpips": None}, "missing": {"lpips": "no weights"}}, "B has none: no weights", 0),
    ],
)  # fmt: skip
def test_a_score_that_cannot_be_compared_leaves_the_others(tmp_path, capsys, extra, said, status):
    a, b = two_experiments(tmp_path, [20.0], [20.0], **extra)
    assert main([str(a), str(b), "--out", str(tmp_path / "out")]) == status
    out = capsys.readouterr().out
    assert f"found: LPIPS: not compared, {said}\n" in out and "all scores that are compared are identical" in out
    table = pd.read_csv(tmp_path / "out" / "compare.csv").set_index("metric")
    assert (table.loc["lpips", "verdict"], table.loc["lpips", "reason"]) == ("not compared", said)
    assert np.isnan(table.loc["lpips", "difference"]) and table.loc["ssim", "verdict"] == "identical"
    assert status == 0 or "what differs: protocol (LPIPS alone)\n" in out


def test_images_in_a_palette_are_marked(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0], [20.0], channels=3)
    main([str(a), str(b), "--out", str(tmp_path / "out")])
    assert "│ Truck † │" in (said := capsys.readouterr().out) and "\n† palette, not temperature\n" in said
    assert "assumed" not in said
    assert set(pd.read_csv(tmp_path / "out" / "compare.csv")["image_values"]) == {"palette, not temperature"}
    page = HtmlPage((tmp_path / "out" / "compare.html").read_text())
    assert "† palette, not temperature" in page.texts and page.tables[0][1][0] == "Truck †"


def test_without_a_common_cell_the_folders_are_named(tmp_path, capsys):
    write(tmp_path / "a", seed=0)
    write(tmp_path / "b", seed=1)
    assert main([str(tmp_path / "a"), str(tmp_path / "b")]) == 2
    assert "share no finished cell" in capsys.readouterr().err
    assert main([str(tmp_path / "a"), str(tmp_path / "c")]) == 2


def test_page_and_table_show_the_view_that_differs_most(tmp_path, small_results, monkeypatch):
    a, b = (shutil.copytree(small_results, tmp_path / name) for name in "ab")
    folder = next(path.parent for path in sorted(b.rglob("record.json")) if read_record(path.parent).failure is None)
    views = pd.read_csv(folder / "views.csv")
    views.loc[1, "psnr"] += 3
    views.to_csv(folder / "views.csv", index=False, na_rep="n/a")
    picture = folder / "renders" / f"{views.loc[1, 'view']}.png"
    Image.fromarray(255 - np.asarray(Image.open(picture))).save(picture)
    other = next(path for path in sorted(b.rglob("views.csv")) if path.parent != folder)
    other.write_text("")
    assert main([str(a), str(b), "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "compare.html").read_text()
    assert "n/a: views.csv is missing or unusable" in page
    assert f"test view {views.loc[1, 'view']}" in page
    places = len(pairs_of(a, b))
    assert page.count("<figure>") == 3 * (places - 1) and "more scenes" not in page
    table = pd.read_csv(tmp_path / "out" / "compare.csv")
    assert set(table["verdict"].dropna()) == {"identical", "not compared"}
    monkeypatch.setattr(comparison_page, "MOST_PICTURES", 1)
    assert main([str(a), str(b), "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "compare.html").read_text()
    assert f"{places - 1} more scenes and methods have none here." in page


def test_an_average_over_equal_places_says_so(tmp_path, capsys):
    for name, gain in (("a", 0.0), ("b", 1.0)):
        for seed in range(3):
            write(tmp_path / name, scene="Truck", seed=seed, scores={"psnr": 20.0 + seed / 10 + gain})
            write(tmp_path / name, scene="Ebike", seed=seed, scores={"psnr": 20.0})
    main([str(tmp_path / "a"), str(tmp_path / "b")])
    assert "B − A +0.500 dB on average, the identical ones too, 90 % interval over seeds +" in capsys.readouterr().out

"""`tdgbench compare A B`: pairs of cells, verdicts on their differences, and what differs behind them."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from tdgbench.cells.protocol import protocol_settings
from tdgbench.cells.record import Failure, read_record
from tdgbench.compare.causes import ADDED, MACHINE, PROTOCOL, TRAINING, VERSION, find_causes, settings
from tdgbench.compare.compare_command import main
from tdgbench.compare.compared_cells import CHANGED, score_table
from tdgbench.compare.pairs import find_pairs
from tdgbench.tables.results import read_results
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import record, write


def pairs_of(a, b):
    return find_pairs(*(read_results(folder).cells for folder in (a, b)))


def two_experiments(tmp_path, psnr_a, psnr_b, **extra):
    """Folders A and B with a cell per seed, whose PSNR are given; `extra` changes records of B."""
    for name, values, more in (("a", psnr_a, {}), ("b", psnr_b, extra)):
        for seed, psnr in enumerate(values):
            write(tmp_path / name, seed=seed, **{"scores": {"psnr": psnr}, **more})
    return tmp_path / "a", tmp_path / "b"


def rows_of(a, b):
    pairs = pairs_of(a, b)
    return score_table(pairs, find_causes(pairs)).set_index("metric")


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


def test_a_seed_that_failed_on_both_sides_is_named(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0], [20.0])
    for folder in (a, b):
        write(folder, seed=1, status="failed", failure=Failure("train", "ValueError: no", ""), scores={})
    main([str(a), str(b)])
    assert "failed in A and B: tdg on RGBT-Scenes/Truck, colmap, seed 1 (failed in train" in capsys.readouterr().out


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


def test_files_of_a_prior_are_of_the_training_and_those_of_a_scene_of_the_data(tmp_path, capsys):
    a, b, c = tmp_path / "a", tmp_path / "b", tmp_path / "c"
    for folder, data, views in ((a, "abc", 4), (b, "abc-1", 4), (c, "abd", 5)):
        write(folder, scores={"psnr": 20.0}, data=data, views={"train": 8, "test": views})
    kinds = {cause.name: (cause.kind, cause.values) for cause in find_causes(pairs_of(a, b))}
    assert kinds["files of the prior"] == (TRAINING, ("null", "1")) and "data" not in kinds
    assert main([str(a), str(b)]) == 0
    assert "two protocols" not in capsys.readouterr().out
    assert main([str(a), str(c)]) == 1
    assert "found: no score is compared: other data of the scene (data: abc → abd; " in capsys.readouterr().out


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


def test_options_of_another_kind_of_group_are_no_difference_of_versions(tmp_path):
    def config(kind, **more):
        return {"budget": {"name": "paper", "iterations": 9, "density": {"_target_": kind, **more}}}

    a, b = tmp_path / "a", tmp_path / "b"
    write(a, config=config("DensityRules"))
    write(b, config=config("RelocationRules", noise=5.0))
    kinds = {cause.name: cause.kind for cause in find_causes(pairs_of(a, b))}
    assert kinds["budget.density.noise"] == kinds["budget.density._target_"] == TRAINING
    write(tmp_path / "c", config=config("DensityRules", noise=5.0))
    kinds = {cause.name: cause.kind for cause in find_causes(pairs_of(a, tmp_path / "c"))}
    assert kinds == {"budget.density.noise": VERSION}


def test_memory_is_not_compared_and_an_estimated_camera_is_said(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0], [20.0], config={"thermal_camera": {"estimate": True}}, peak_rss_mb=900)
    assert rows_of(a, b).loc["memory_mb", "verdict"] == "not compared"
    main([str(a), str(b)])
    out = capsys.readouterr().out
    assert "found: in B, renders are scored as the estimated thermal camera shows them" in out and "in A, " not in out


def test_a_setting_of_some_seeds_names_where(tmp_path):
    a, b = two_experiments(tmp_path, [20.0, 21.0], [20.0])
    write(b, seed=1, scores={"psnr": 21.0}, init_points={"count": 9})
    (cause,) = (cause for cause in find_causes(pairs_of(a, b)) if cause.name == "init_points.count")
    assert cause.sentence(2).endswith("(in 1 of 2 cells: TDg on Truck, some of their seeds alone)")


def test_what_differs_is_told_by_what_it_decides(tmp_path):
    config = {"metrics": {"ssim_border": "valid"}, "budget": {"name": "paper", "_target_": "Budget", "iterations": 9}}
    a, b = two_experiments(
        tmp_path, [20.0, 21.0], [20.0, 21.0], config=config, environment={"packages": {"torch": "3"}}
    )
    causes = {cause.name: cause for cause in find_causes(pairs_of(a, b))}
    assert {name: cause.kind for name, cause in causes.items()} == {
        "metrics.ssim_border": PROTOCOL, "budget._target_": TRAINING,
        "iterations": TRAINING,
        "packages.torch": MACHINE,
    }  # fmt: skip
    assert causes["iterations"].values == ("0", "9") and causes["iterations"].sentence(2) == "iterations: 0 → 9"
    assert causes["iterations"].sentence(3).endswith("(in 2 of 3 cells: TDg on Truck)")


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


def test_another_psnr_of_equal_renders_is_a_changed_record(tmp_path, capsys):
    for name, gain in (("a", 0.0), ("b", 0.3)):
        for seed in range(3):
            hashes = {"model.ply": f"{seed}" * 64, "renders/1.png": "cd" * 32}
            write(tmp_path / name, seed=seed, scores={"psnr": 20.0 + seed / 10 + gain}, hashes=hashes)
    assert main([str(tmp_path / "a"), str(tmp_path / "b")]) == 1
    first = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("found: "))
    assert first.startswith("found: a record was changed: renders, ground truth and protocol are equal, PSNR not")
    row = rows_of(tmp_path / "a", tmp_path / "b").loc["psnr"]
    assert (row["verdict"], row["reason"]) == ("not compared", CHANGED) and np.isnan(row["difference"])


def test_an_option_of_the_budget_that_a_version_lacks_is_no_other_training(tmp_path):
    budgets = {"name": "demo", "iterations": 9}, {"name": "demo", "iterations": 9, "rays": 512}
    for name, budget in zip("ab", budgets, strict=True):
        write(tmp_path / name, config={"budget": budget})
    (cause,) = find_causes(pairs_of(tmp_path / "a", tmp_path / "b"))
    assert (cause.kind, cause.change) == (VERSION, "budget.rays: not recorded → 512")


def test_a_rule_of_the_budget_that_is_switched_off_is_another_training(tmp_path):
    for name, growth in (("a", {"views": 3, "z": 2.0}), ("b", None)):
        write(tmp_path / name, config={"budget": {"name": "lean", "iterations": 9, "growth": growth}})
    causes = find_causes(pairs_of(tmp_path / "a", tmp_path / "b"))
    assert causes and {cause.kind for cause in causes} == {TRAINING}


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


def test_a_training_that_was_scored_again_is_no_repeat(tmp_path, capsys):
    hashes = dict.fromkeys(("log.csv", "model.ply", "views.csv"), "0" * 64)
    for name, changed in (("a", {}), ("b", {"views.csv": "1" * 64})):
        write(tmp_path / name, hashes=hashes | changed)
    assert main([str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    out = capsys.readouterr().out
    assert "found: nothing was trained twice: " in out and "std of a repeat" not in out
    assert rows_of(tmp_path / "a", tmp_path / "b").loc["train_hours", "verdict"] == "not compared"


def test_other_assumptions_come_before_the_numbers(tmp_path, capsys):
    a, b = two_experiments(tmp_path, [20.0], [21.0], assumed={"size": "640×480 px, bilinear", "depth": "16 bits"})
    for path in a.rglob("record.json"):
        stated = '"assumed": {"depth": "16 bits", "size": "160×120 px"}'
        path.write_text(path.read_text().replace('"assumed": {}', stated))
    main([str(a), str(b), "--out", str(tmp_path / "out")])
    said = capsys.readouterr().out
    line = "RGBT-Scenes/Truck, size: 160×120 px → 640×480 px, bilinear"
    assert said.index(f"assumed: {line}") < said.index("│ Truck") and "16 bits" not in said
    assert "found: assumed differently, in 1 scene: size; " in said
    page = HtmlPage((tmp_path / "out" / "compare.html").read_text())
    assert {line, "160×120 px (A)", "640×480 px, bilinear (B)", "16 bits"} <= page.texts


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


def test_page_and_table_show_the_view_that_differs_most(tmp_path, small_results, capsys):
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
    assert page.count("<figure>") == 3 * (len(pairs_of(a, b)) - 1)
    table = pd.read_csv(tmp_path / "out" / "compare.csv")
    assert set(table["verdict"].dropna()) == {"identical", "not compared"}


def test_the_place_of_weights_is_no_protocol():
    config = {"metrics": {"lpips": {"net": "vgg", "weights": "vgg.npz", "weights_sha256": "ab"}, "extra": "a.B"}}
    kinds = {name: kind for kind, name in settings(record(config=config))}
    assert kinds["metrics.lpips.weights"] == VERSION
    assert {name for name in kinds if name.startswith("metrics.")} - {ADDED, "metrics.lpips.weights"} == {
        *protocol_settings(config)
    }
    assert kinds["metrics.lpips.weights_sha256"] == kinds["metrics.lpips.net"] == PROTOCOL


def test_the_backend_that_trained_is_no_repeat(tmp_path, capsys):
    """Its option is `auto` on both sides."""
    for name, backend, psnr in (("a", "cpu", 20.0), ("b", "warp", 20.1)):
        for seed in range(2):
            config = {"backend": {"name": "auto"}, "budget": {"name": "paper"}}
            write(tmp_path / name, seed=seed, backend=backend, config=config, scores={"psnr": psnr + seed})
    assert main([str(tmp_path / "a"), str(tmp_path / "b")]) == 0
    assert "found: what differs: training (backend that trained cpu → warp)" in capsys.readouterr().out
    assert np.isnan(rows_of(tmp_path / "a", tmp_path / "b").loc["psnr", "repeat_std"])


def test_priors_of_two_kinds_name_their_side(tmp_path, capsys):
    for name, source in (("a", "truth"), ("b", "thermal images")):
        write(tmp_path / name, prior={"estimator": "any", "made_from": source})
    main([str(tmp_path / "a"), str(tmp_path / "b")])
    out = capsys.readouterr().out
    assert (
        "in A: The depth prior of TDg is made from true depth; in B: no depth prior of more than thermal images" in out
    )
    assert "prior.made_from truth → thermal images" in out


def test_causes_of_times_name_their_cells(tmp_path, capsys):
    for name, at_once, channels in (("a", 1, 1), ("b", 2, 3)):
        write(tmp_path / name, scene="Truck", environment={"cells_at_once": at_once})
        write(tmp_path / name, scene="Dimsum", channels=channels)
        write(tmp_path / name, scene="Ebike")
    main([str(tmp_path / "a"), str(tmp_path / "b")])
    out = capsys.readouterr().out
    assert "found: times of TDg on Truck may differ because of the machine's settings: cells_at_once 1 → 2\n" in out
    assert "found: times of TDg on Dimsum do not compare: channels 1 → 3\n" in out


def test_doubts_name_whose_they_are(tmp_path, capsys):
    for name in "ab":
        write(tmp_path / name, doubts=["6 of 32 cameras look wrong"])
        own = {"doubts": ["6 of 32 cameras look wrong", "the renders look shifted"], "has_doubts_of_its_own": True}
        write(tmp_path / name, "msmg", **own)
    main([str(tmp_path / "a"), str(tmp_path / "b")])
    out = capsys.readouterr().out
    assert "doubt: RGBT-Scenes/Truck: 6 of 32 cameras look wrong\n" in out and out.count("look wrong") == 1
    assert "doubt: RGBT-Scenes/Truck: the renders look shifted (MSMG)\n" in out


def test_an_average_over_equal_places_says_so(tmp_path, capsys):
    for name, gain in (("a", 0.0), ("b", 1.0)):
        for seed in range(3):
            write(tmp_path / name, scene="Truck", seed=seed, scores={"psnr": 20.0 + seed / 10 + gain})
            write(tmp_path / name, scene="Ebike", seed=seed, scores={"psnr": 20.0})
    main([str(tmp_path / "a"), str(tmp_path / "b")])
    assert "B − A +0.500 dB on average, the identical ones too, 90 % interval over seeds +" in capsys.readouterr().out

"""What differs between two experiments, and what it decides."""

from __future__ import annotations

import numpy as np

from tdgbench.cells.protocol import protocol_settings
from tdgbench.compare.causes import ADDED, MACHINE, PROTOCOL, TRAINING, VERSION, find_causes, settings
from tdgbench.compare.compare_command import main
from tdgbench.compare.compared_cells import CHANGED
from tests.helpers.compared import pairs_of, rows_of, two_experiments
from tests.helpers.html_page import HtmlPage
from tests.helpers.records import record, write


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

import copy

import pandas as pd
import pytest

from tdgbench.bench.options import OptionError
from tdgbench.cells.record import Record, read_all
from tdgbench.experiments.matrix import MatrixCell, table_of
from tdgbench.experiments.skips import NAMES, SkipAblation, numbers, summary, variants, with_changes
from tdgbench.training.budget import SKIP_RULES as RULES
from tdgbench.training.skips import SWITCHES
from tests.helpers.configs import SMALL, config


def test_variants():
    usual = {**dict.fromkeys(NAMES, True), "prior": False}
    made = variants(["gray", "depth", "prior"], usual)
    assert list(made) == ["none", "all", "only gray", "without gray", "only depth", "without depth", "only prior"]
    on = {label: [name for name, is_on in options.items() if is_on] for label, options in made.items()}
    assert on["none"] == [] and on["all"] == ["gray", "depth"] and on["only prior"] == ["prior"]
    assert on["only gray"] == ["gray"] and on["without depth"] == ["gray"]
    with pytest.raises(ValueError, match="there is no skip grey"):
        variants(["grey"], usual)


def test_cells_of_every_variant(tmp_path, data_root, capsys):
    cfg = config(
        "+experiment=skips", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "budget.iterations=12",
        "study.scenes=[turntable]", "study.skips=[gray]",
    )  # fmt: skip
    cells = SkipAblation().run_cells(cfg)
    assert [cell.outcome.status for cell in cells] == ["ok"] * 4
    assert [cell.labels["variant"] for cell in cells] == ["none", "all", "only gray", "without gray"]
    assert capsys.readouterr().err.count("done") == 4
    records = {r.variant: r for r in read_all(tmp_path / "skips")}
    assert {cell.labels["variant"]: cell.record for cell in cells} == records
    assert {name: r.channels for name, r in records.items()} == {
        "none": 3, "all": 1, "only gray": 1, "without gray": 3,
    }  # fmt: skip
    skips = {s["name"]: s for s in records["all"].skips}
    assert skips["gray"]["taken"] and skips["gray"]["saved"] == "2 of 3 channels"
    assert not skips["rgb"]["taken"] and skips["rgb"]["reason"] == "switched off"
    off = {s["name"]: s["reason"] for s in records["none"].skips}
    assert list(off) == list(NAMES)
    assert all(off[name] == "switched off" for name in SWITCHES)
    assert all(off[name] == f"the budget has no rule for {name}" for name in RULES)
    assert [cell.outcome.status for cell in SkipAblation().run_cells(cfg)] == ["kept"] * 4


def rows_of(records):
    cells = [MatrixCell({"scene": r.scene, "seed": r.seed, "variant": r.variant}, None, None, r) for r in records]
    return with_changes(table_of(cells, numbers))


def record(scene, variant, seconds, psnr, ssim=0.9, taken=()):
    skips = [{"name": n, "allowed": True, "taken": True, "reason": "so; gray: no", "saved": "much"} for n in taken]
    return Record(
        method="tdg", dataset="synthetic", scene=scene, init="colmap", seed=0, experiment="skips", variant=variant,
        seconds={"train": seconds, "load": 1.0}, scores={"psnr": psnr, "ssim": ssim, "lpips": None}, skips=skips,
        parts={"thermal": {"gaussians": 5}}, peak_rss_mb=100.0, iterations=10,
    )  # fmt: skip


RECORDS = [
    record("a", "none", 8.0, 30.0), record("a", "all", 2.0, 29.99, taken=["gray"]),
    record("a", "only gray", 4.0, 30.0, taken=["gray"]), record("a", "without gray", 4.0, 30.0),
    record("b", "none", 8.0, 30.0), record("b", "all", 8.0, 29.9), record("b", "only gray", 8.0, 30.02, taken=["rgb"]),
    record("b", "without gray", 8.0, 30.0),
]  # fmt: skip


def summary_of(records, names=("gray",), scenes=None):
    """The summary of trainings, of which those in `scenes` may have no record at all."""
    places = {(scene, seed) for scene in scenes or {r.scene for r in records} for seed in {r.seed for r in records}}
    return summary(rows_of(records), list(names), pd.MultiIndex.from_tuples(sorted(places), names=["scene", "seed"]))


def test_rows_compare_with_the_same_scene_without_skips():
    table = rows_of(RECORDS).set_index(["scene", "variant"])
    assert table.loc[("a", "all"), "change of psnr"] == pytest.approx(-0.01)
    assert table.loc[("b", "all"), "change of psnr"] == pytest.approx(-0.1)
    left_out = table.loc["a", "left_out"]
    assert left_out["all"] == "gray: much (so; gray: no)" and left_out["none"] == ""


def test_summary():
    table = summary_of(RECORDS).set_index("skip")
    assert table.loc["gray", "faster_alone"] == pytest.approx(2**0.5)
    assert table.loc["gray", "slower_without"] == pytest.approx(2**0.5)
    assert table.loc["gray", "taken_on"] == "a" and list(table["scenes"]) == [2, 2] and list(table["seeds"]) == [1, 1]
    assert table.loc["gray", "default_may_be"] == "undecided"  # +0.02 dB on b, with one seed
    assert table.loc["all together", "faster_alone"] == pytest.approx(2.0)
    assert table.loc["all together", "psnr_worst"] == pytest.approx(-0.1)
    assert table.loc["all together", "default_may_be"] == "undecided"


def test_a_loss_within_the_noise_of_the_seeds_is_none():
    changes = {"a": [-0.3, 0.2, 0.1], "b": [-0.11, -0.10, -0.12], "c": [-0.01, -0.02, -0.015], "d": [0.0]}

    def cells(scene):
        for seed, change in enumerate(changes[scene]):
            for variant, psnr in (("none", 30.0), ("only gray", 30.0 + change)):
                one = record(scene, variant, 1.0, psnr, taken=["gray"] * (variant != "none"))
                one.seed = seed
                yield one

    noisy = summary_of(list(cells("a"))).iloc[0]
    assert (
        noisy["default_may_be"] == "undecided"
        and noisy["psnr_worst"] == pytest.approx(0.0)
        and noisy["psnr_error"] > 0.1
    )
    steady = summary_of([*cells("a"), *cells("b")]).iloc[0]
    assert steady["default_may_be"] == "off" and steady["psnr_worst"] == pytest.approx(-0.11)

    for scene in ("c", "d"):  # small, and none with one seed
        assert summary_of(list(cells(scene))).iloc[0]["default_may_be"] == "on"


def test_a_missing_cell_a_busy_machine_and_a_skip_that_was_not_taken_have_no_verdict():
    some = [one for one in RECORDS if (one.scene, one.variant) != ("b", "only gray")]
    row = summary_of(some).iloc[0]
    assert row["default_may_be"] == "n/a" and pd.isna(row["faster_alone"]) and pd.isna(row["psnr_worst"])
    assert row["slower_without"] == pytest.approx(2**0.5)
    busy = copy.deepcopy(RECORDS)
    busy[0].backend, busy[0].train_processor_seconds = "cpu", 4.0  # of 8 s
    assert pd.isna(summary_of(busy).iloc[0]["faster_alone"])
    idle = copy.deepcopy(RECORDS)
    for one in idle:
        one.skips = []
    failed = summary_of([one for one in RECORDS if one.scene == "a"], scenes=["a", "b"])
    assert (failed["default_may_be"] == "n/a").all() and list(failed["scenes"]) == [2, 2]
    assert failed[["faster_alone", "slower_without", "memory_alone", "psnr_worst"]].isna().all(axis=None)
    found = summary_of(idle)
    assert (found["default_may_be"] == "n/a").all() and found["faster_alone"].isna().all()
    assert found["slower_without"].isna().all() and found["memory_alone"].isna().all()


def test_a_rule_that_the_budget_lacks_is_refused(tmp_path, data_root):
    cfg = config("+experiment=skips", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "study.skips=[growth]")
    with pytest.raises(OptionError, match="the budget has no rule growth; `budget=lean` has most"):
        SkipAblation().run_cells(cfg)


def test_cells_of_the_run_alone_have_a_row_and_failed_ones_none(tmp_path, data_root, capsys):
    """A scene that is not there; cells of another method in the same folder."""
    words = (
        "+experiment=skips", *SMALL, f"data.root={data_root}", f"results={tmp_path}", "budget.iterations=12",
    )  # fmt: skip
    SkipAblation().run(config(*words, "method=3dgs", "study.scenes=[turntable]", "study.skips=[]"))
    with pytest.raises(SystemExit):
        SkipAblation().run(config(*words, "study.scenes=[orbit, nowhere]", "study.skips=[depth]"))
    table = pd.read_csv(tmp_path / "skips" / "skips.csv").set_index("skip")
    assert list(table.index) == ["depth", "all together"] and table.loc["depth", "taken_on"] == "orbit"
    assert (table["image_values"] == "palette, not temperature").all()
    rows = pd.read_csv(tmp_path / "skips" / "skips_cells.csv")
    assert len(rows) == 4 and rows.columns[-1] == table.columns[-1] == "image_values"
    said = capsys.readouterr().out
    assert "faster" in said and "nowhere" in said

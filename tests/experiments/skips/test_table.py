import pytest

from tdgbench.bench.record import Record
from tdgbench.experiments.skips.table import skip_rows, summary


def record(scene, variant, seconds, psnr, ssim=0.9, taken=()):
    skips = [{"name": n, "allowed": True, "taken": True, "reason": "so", "saved": "much"} for n in taken]
    return Record(
        method="tdg", dataset="synthetic", scene=scene, init="colmap", seed=0, experiment="skips", variant=variant,
        seconds={"train": seconds, "load": 1.0}, scores={"psnr": psnr, "ssim": ssim, "lpips": None}, skips=skips,
        gaussians={"thermal": 5}, peak_rss_mb=100.0, iterations=10,
    )  # fmt: skip


RECORDS = [
    record("a", "none", 8.0, 30.0), record("a", "all", 2.0, 29.99, taken=["gray"]),
    record("a", "only gray", 4.0, 30.0, taken=["gray"]), record("a", "without gray", 4.0, 30.0),
    record("b", "none", 8.0, 30.0), record("b", "all", 8.0, 29.9), record("b", "only gray", 8.0, 30.02),
    record("b", "without gray", 8.0, 30.0),
]  # fmt: skip


def test_rows_compare_with_the_same_scene_without_skips():
    table = skip_rows(RECORDS).set_index(["scene", "variant"])
    assert table.loc[("a", "all"), "change of psnr"] == pytest.approx(-0.01)
    assert table.loc[("b", "all"), "change of psnr"] == pytest.approx(-0.1)
    assert table.loc[("a", "all"), "left_out"] == "gray: much (so)" and table.loc[("a", "none"), "left_out"] == ""


def test_summary():
    table = summary(skip_rows(RECORDS), ["gray"]).set_index("skip")
    assert table.loc["gray", "faster_alone"] == pytest.approx(2**0.5)
    assert table.loc["gray", "slower_without"] == pytest.approx(2**0.5)
    assert table.loc["gray", "taken_on"] == "a" and bool(table.loc["gray", "keep"])
    assert table.loc["all together", "faster_alone"] == pytest.approx(2.0)
    assert table.loc["all together", "psnr_worst"] == pytest.approx(-0.1) and not table.loc["all together", "keep"]


def test_a_loss_within_the_noise_of_the_seeds_is_none():
    changes = {"a": [-0.3, 0.2, 0.1], "b": [-0.11, -0.10, -0.12]}

    def cells(scene):
        for seed, change in enumerate(changes[scene]):
            for variant, psnr in (("none", 30.0), ("only gray", 30.0 + change)):
                one = record(scene, variant, 1.0, psnr)
                one.seed = seed
                yield one

    noisy = summary(skip_rows(list(cells("a"))), ["gray"]).iloc[0]
    assert noisy["keep"] and noisy["psnr_worst"] == pytest.approx(0.0) and noisy["psnr_error"] > 0.1
    steady = summary(skip_rows([*cells("a"), *cells("b")]), ["gray"]).iloc[0]
    assert not steady["keep"] and steady["psnr_worst"] == pytest.approx(-0.11)

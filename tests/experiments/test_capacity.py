import pandas as pd
import pytest

from tdgbench.bench.options import OptionError
from tdgbench.experiments import capacity
from tdgbench.experiments.capacity import UNEQUAL, Capacity, at_equal_numbers, over_seeds_of_times
from tdgbench.experiments.error_time import best_after
from tdgbench.experiments.matrix import configured
from tests.helpers.configs import config


def row(scene, seed, run, psnr, had=60):
    return {
        "scene": scene, "seed": seed, "run": run, "gaussians": 60, "had": had, "of_all_sets": 2 * had,
        "iterations": 9, "train_seconds": 2.0, "processor_seconds": None, "psnr": psnr, "ssim": 0.9, "lpips": None,
        "image_values": "",
    }  # fmt: skip


def test_gains_are_of_equal_numbers_over_seeds_and_over_scenes_that_all_have_them():
    gains = {"a": [1.0, 2.0, 3.0], "b": [2.0, 2.0, 2.0]}
    cells = [
        row(scene, seed, run, 30.0 - (gain if run == "other" else 0), had)
        for scene, of_seeds in gains.items()
        for seed, gain in enumerate(of_seeds)
        for run, had in (("first", 60), ("other", 60), ("more", 60 if scene == "a" else 61))
    ]
    found = at_equal_numbers(pd.DataFrame(cells), "first").set_index(["scene", "run"])
    a, b, both = (found.loc[(scene, "other")] for scene in ("a", "b", "all scenes"))
    assert (a.psnr, a.psnr_gain, a.verdict) == (28.0, 2.0, "undecided")
    assert a.psnr_gain_half == pytest.approx(2.484, abs=1e-3)  # 4.303 · 1 / √3
    assert (b.psnr_gain, b.psnr_gain_half, b.verdict) == (2.0, 0.0, "better")
    assert (both.psnr_gain, both.psnr_gain_half, both.seeds) == (2.0, 0.0, 3)
    assert pd.isna(a.lpips) and pd.isna(a.lpips_gain) and (a.had, a.of_all_sets) == ("60", "120")
    more = found.xs("more", level="run")["verdict"]
    assert list(more) == ["undecided", UNEQUAL, UNEQUAL] and found.loc[("all scenes", "more")].had == "60 to 61"
    assert set(found.xs("first", level="run")["verdict"]) == {""}
    fewer = [{**cell, "had": 61} if cell["seed"] == 1 and cell["run"] == "other" else cell for cell in cells]
    fewer += [{**cell, "run": "blank", "ssim": None if cell["scene"] == "b" else 0.9} for cell in cells[::3]]
    found = at_equal_numbers(pd.DataFrame(fewer), "first").set_index(["scene", "run"])
    assert found.loc[("a", "other"), "verdict"] == UNEQUAL  # two of three seeds are no gain
    assert pd.isna(found.loc[("all scenes", "blank"), "ssim"]) and pd.isna(
        found.loc[("all scenes", "blank"), "ssim_gain"]
    )
    lost = [cell for cell in cells if (cell["scene"], cell["run"]) != ("b", "other")]
    found = at_equal_numbers(pd.DataFrame(lost), "first").set_index(["scene", "run"])
    assert pd.isna(found.loc[("all scenes", "other"), "psnr"]) and found.loc[("a", "other"), "psnr"] == 28.0
    assert found.loc[("all scenes", "first"), "psnr"] == 30.0


def test_the_best_scores_so_far_and_whether_they_are_final():
    curves = pd.DataFrame(
        {
            "scene": "s", "seed": [0, 0, 0, 1, 1], "label": "r", "seconds": [5.0, 20.0, 40.0, 5.0, 15.0],
            "psnr": [20.0, 27.0, 26.0, 22.0, 23.0], "ssim": 0.5, "lpips": [0.3, 0.2, 0.1, 0.3, 0.4],
            "image_values": "",
        }
    )  # fmt: skip
    found = over_seeds_of_times(best_after(curves, [1.0, 30.0, 60.0]), 2).set_index("after")
    assert pd.isna(found.loc[1.0, "psnr"]) and list(found["ended"]) == [0, 1, 2]
    assert list(found["seeds"]) == [0, 2, 2] and list(found["psnr"][1:]) == [25.0, 25.0]
    assert list(found["lpips"][1:]) == pytest.approx([0.25, 0.2])
    later = curves.assign(seconds=curves["seconds"] + 30 * curves["seed"])
    failed = over_seeds_of_times(best_after(curves, [60.0]), 3)
    assert pd.isna(failed["psnr"][0]) and failed["seeds"][0] == 2  # the third seed's training failed
    late = over_seeds_of_times(best_after(later, [20.0]), 2)
    assert pd.isna(late["psnr"][0]) and late["seeds"][0] == 1  # a mean would be of the faster seed


def test_cells_differ_in_run_and_number_alone(monkeypatch):
    cfg = config("+experiment=capacity", "study.gaussians=[5000,6000]")
    runs, numbers = (Capacity().axes(cfg)[name] for name in ("run", "gaussians"))
    assert [one.variant for one in runs] == ["", "", "", "", "budget=lean"]
    cell = configured(cfg, [runs[-1], numbers[1]])
    assert (cell.method.name, cell.budget.name, cell.budget.gaussians) == ("tdg", "lean", 6000)
    assert (configured(cfg, [runs[3], numbers[0]]).budget.name, numbers[0].variant) == ("demo", "gaussians=5000")
    monkeypatch.setattr(capacity.Matrix, "run", lambda self, cfg: None)
    monkeypatch.setattr(capacity, "sample_all", lambda cfg: 1 / 0)
    cfg.study.times = []
    Capacity().run(cfg)  # no times, no curves
    with pytest.raises(OptionError, match=r"budget\.gaussians=70: is set by the experiment; give study\.gaussians"):
        Capacity().check_typed(["budget.iterations=9", "budget.gaussians=70"])

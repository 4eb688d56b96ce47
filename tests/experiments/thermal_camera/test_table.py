import numpy as np
import pandas as pd
import pytest

from tdgbench.experiments.thermal_camera.table import as_text, summary

CAPTURES, CAMERAS, BASELINE = ["clean", "drift"], ["ideal", "estimated"], ("clean", "ideal")
SCORES = {
    ("clean", "ideal"): 40.0,
    ("clean", "estimated"): 39.0,
    ("drift", "ideal"): 30.0,
    ("drift", "estimated"): 38.0,
}


def cells(scores=SCORES, seeds=(0, 1)) -> pd.DataFrame:
    rows = [
        {"scene": "a", "capture": capture, "method": "splat", "camera": camera, "seed": seed, "psnr": 20.0,
         "psnr_affine": 21.0, "psnr_right_half": np.nan, "psnr_true": score + seed, "ssim": 0.5, "mae_degC": 1.0,
         "mae_degC_without_offset": 0.5, "offset_degC_worst": 0.1, "gain_worst": 0.01, "vignette_degC_worst": 0.2,
         "train_seconds": 2.0, "camera_seconds": 0.5, "notes": ""}
        for (capture, camera), score in scores.items() for seed in seeds
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_recovered_is_the_share_of_what_the_errors_cost():
    table = summary(cells(), CAPTURES, CAMERAS, BASELINE).set_index(["capture", "camera"])
    assert table.loc[("drift", "estimated"), "recovered"] == pytest.approx(0.8)
    assert table["recovered"].isna().sum() == 3
    assert table.loc[("drift", "estimated"), "psnr_true"] == 38.5 and (table["seeds"] == 2).all()
    assert table["psnr_true_error"].to_numpy() == pytest.approx(0.5)


def test_little_lost_has_no_share():
    scores = {**SCORES, ("drift", "ideal"): 39.7}
    assert summary(cells(scores), CAPTURES, CAMERAS, BASELINE)["recovered"].isna().all()


def test_rows_stand_in_the_order_of_captures_and_cameras():
    table = summary(cells(dict(reversed(SCORES.items()))), CAPTURES, CAMERAS, BASELINE)
    assert list(zip(table["capture"], table["camera"], strict=True)) == list(SCORES)
    shown = as_text(summary(cells(seeds=(0,)), CAPTURES, CAMERAS, BASELINE))
    assert shown["right half"].tolist() == ["n/a"] * 4 and shown["±"].tolist() == ["n/a"] * 4
    assert shown["recovered"].tolist() == ["n/a"] * 3 + ["80%"]


def test_a_seed_without_its_baseline_has_no_part():
    some = cells()
    without = some[~((some["capture"] == "clean") & (some["camera"] == "ideal") & (some["seed"] == 1))].copy()
    without.loc[(without["capture"] == "drift") & (without["seed"] == 1), "psnr_true"] = 90.0
    table = summary(without, CAPTURES, CAMERAS, BASELINE).set_index(["capture", "camera"])
    assert table.loc[("drift", "estimated"), "recovered"] == pytest.approx(0.8)
    assert summary(some, CAPTURES, CAMERAS, (None, "ideal"))["recovered"].isna().all()

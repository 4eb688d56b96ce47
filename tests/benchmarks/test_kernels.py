import pandas as pd
import pytest

from benchmarks import kernels
from benchmarks.common.clouds import random_cloud
from benchmarks.kernels import BASELINE, measure, non_dominated, settings
from tests.helpers.command import program_here


@pytest.fixture(scope="module")
def table():
    return measure({"small": random_cloud(2000, 64, 48)}, repetitions=2, slow=True).set_index("setting")


def test_every_setting_is_timed_and_compared(table):
    assert list(table.index) == list(settings(slow=True))
    assert (table[["forward_ms", "both_ms"]] > 0).all().all()
    assert table.loc[BASELINE, "both_ratio"] == 1 and table["gaussians"].eq(2000).all()


def test_errors_are_those_of_the_settings(table):
    errors = table[["image_error", "depth_error", "gradient_error"]]
    assert (errors.loc["torch float64"] == 0).all()
    for exact in (BASELINE, "cpu, 1 thread", "cpu, tiles never end early", "torch float32"):
        assert (errors.loc[exact] < 1e-3).all(), exact  # thresholds may flip at a pixel
    for coarse in ("cpu, alpha cut at 1/64", "cpu, stop at T 1e-2"):
        assert (errors.loc[coarse] > 10 * errors.loc[BASELINE]).all(), coarse
    assert (errors.loc["cpu, 1 thread"] == errors.loc[BASELINE]).all()


def test_non_dominated():
    table = pd.DataFrame({"t": [1.0, 2.0, 3.0, 2.0, 1.0], "e": [4.0, 2.04, 1.0, 3.0, 4.0]})
    assert list(non_dominated(table, "t", "e")) == [True, True, True, False, True]


def test_runs_small(tmp_path):
    small = ["--counts", "500", "--size", "48x36", "--repetitions", "1", "--out", str(tmp_path)]
    run = program_here(kernels.main, tmp_path, "kernels", *small)
    assert run.returncode == 0, run.stderr[-2000:]
    table = pd.read_csv(tmp_path / "kernels.csv")
    assert table["non_dominated"].any() and list(table["setting"]) == list(settings(slow=False))
    assert (tmp_path / "kernels.png").stat().st_size > 5000
    nothing = program_here(kernels.main, tmp_path, "kernels", "--counts")
    assert nothing.returncode == 2 and "--counts, or --model and --data" in nothing.stderr

import pandas as pd
import pytest

from benchmarks import growth
from benchmarks.growth import AXES, exponents, measure
from tests.helpers.command import program_here


def test_exponents_of_power_laws():
    rows = [{"axis": "gaussians", "size": n, "ms": 3 * n**0.5, "memory_mb": 2 * n} for n in (10, 100, 1000)]
    fitted = exponents(pd.DataFrame(rows)).iloc[0]
    assert fitted["time"] == pytest.approx(0.5) and fitted["memory"] == pytest.approx(1.0)


def test_every_axis_is_measured():
    table = measure(16_000, 48, 36, repetitions=1)
    assert tuple(dict.fromkeys(table["axis"])) == AXES
    assert (table["ms"] > 0).all() and (table["memory_mb"] > 0).all()
    gaussians = table[table["axis"] == "gaussians"]["memory_mb"]
    assert gaussians.iloc[-1] > gaussians.iloc[0], gaussians.tolist()


def test_runs_small(tmp_path):
    small = ["--largest", "1600", "--size", "48x36", "--repetitions", "1", "--out", str(tmp_path)]
    run = program_here(growth.main, tmp_path, "growth", *small)
    assert run.returncode == 0, run.stderr[-2000:]
    assert set(pd.read_csv(tmp_path / "growth_exponents.csv")["axis"]) == set(AXES)
    assert (tmp_path / "growth.png").stat().st_size > 5000

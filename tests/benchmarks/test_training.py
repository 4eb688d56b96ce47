from types import SimpleNamespace

import pandas as pd
import pytest

from benchmarks import training
from benchmarks.training import PART_OF_MODULE, StepProfile
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses.minmax import normalise_rows
from tdgbench.splats.optimizer import Adam
from tests.helpers.command import program_here
from tests.helpers.configs import SMALL
from tests.helpers.paths import ROOT

RULES = "every=5", "fewest=1", "checks=1", "slope_checks=2", "since=0", "full_after=0", "gain=50"
ENDS_EARLY = "budget=lean", *(f"budget.settling.{rule}" for rule in RULES)


GROWS = "budget=lean", "budget.density.start=25", "budget.density.every=5", "budget.pixels=null"
PARTS = {"blend", "blend backward", "Adam", "losses", "Python and torch"}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("method=tdg", "budget=demo"), PARTS), (("method=msmg", "budget=demo"), PARTS),
        (("method=mftg", *ENDS_EARLY), PARTS), (("method=tdg", *GROWS), PARTS | {"growth", "held-out views"}),
        (("method=thermonerf", "budget=demo"), {"hash grid", "networks", "Adam", "Python and torch"}),
    ],
)  # fmt: skip
def test_parts_add_up(tmp_path, data_root, words, expected):
    overrides = [*SMALL, f"data.root={data_root}", "prior=synthetic", *words]
    run = program_here(training.main, tmp_path, "training", *overrides, "--steps", "20", "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr[-2000:]
    table = pd.read_csv(tmp_path / "training.csv")
    assert table["share"].sum() == pytest.approx(1) and (table["ms"] > 0).all()
    assert expected <= set(table["part"])


def test_a_part_within_another_counts_for_that_one_and_functions_are_restored(monkeypatch):
    now = 0.0

    def pass_time(seconds):
        nonlocal now
        now += seconds

    def step(self):
        pass_time(0.5)
        pool.run(normalise_rows, [])

    def run(function, arguments):
        pass_time(2.0)

    monkeypatch.setattr(Adam, "step", step)
    monkeypatch.setattr(pool, "run", run)
    monkeypatch.setattr(training, "time", SimpleNamespace(perf_counter=lambda: now))
    profile = StepProfile()
    with profile.watch():
        Adam.step(None)
        pool.run(normalise_rows, [])
    assert profile.seconds == {"Adam": 2.5, "losses": 2.0}
    assert Adam.step is step and pool.run is run


def test_every_kernel_of_the_losses_has_a_part():
    modules = (ROOT / "tdgbench/splats/cpu/losses").glob("*.py")
    with_kernels = {f"losses.{path.stem}" for path in modules if "\n@kernel()" in path.read_text(encoding="utf-8")}
    assert with_kernels == {name for name in PART_OF_MODULE if name.startswith("losses.")}

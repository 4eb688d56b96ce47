import time

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
    def step(self):
        time.sleep(0.02)
        pool.run(normalise_rows, [])

    def run(function, arguments):
        time.sleep(0.1)

    monkeypatch.setattr(Adam, "step", step)
    monkeypatch.setattr(pool, "run", run)
    profile = StepProfile()
    with profile.watch():
        Adam.step(None)
        pool.run(normalise_rows, [])
    assert 0.12 < profile.seconds["Adam"] < 0.2 and 0.1 < profile.seconds["losses"] < 0.2
    assert Adam.step is step and pool.run is run


def test_every_kernel_of_the_losses_has_a_part():
    modules = [path.stem for path in (ROOT / "tdgbench/splats/cpu/losses").glob("*.py")]
    with_kernels = [name for name in modules if f"losses.{name}" in PART_OF_MODULE]
    assert {"photometric", "rows", "minmax"} <= set(with_kernels)

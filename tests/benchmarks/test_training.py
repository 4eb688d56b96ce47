import pandas as pd
import pytest

from benchmarks import training
from tests.helpers.command import program_here
from tests.helpers.configs import SMALL


@pytest.mark.parametrize("method", ["tdg", "msmg"])
def test_parts_add_up(tmp_path, data_root, method):
    overrides = [*SMALL, f"data.root={data_root}", "prior=synthetic", "budget=demo", f"method={method}"]
    run = program_here(training.main, tmp_path, "training", *overrides, "--steps", "20", "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr[-2000:]
    table = pd.read_csv(tmp_path / "training.csv")
    assert table["share"].sum() == pytest.approx(1) and (table["ms"] > 0).all()
    assert {"blend", "blend backward", "Adam", "losses", "Python and torch"} <= set(table["part"])

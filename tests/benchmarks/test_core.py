import pandas as pd
import pytest

from benchmarks import core
from tests.helpers.command import program_here


def test_runs_small(tmp_path):
    small = ["--counts", "300", "--sizes", "64x48", "--channels", "1", "3+depth", "--repetitions", "2"]
    run = program_here(core.main, tmp_path, "core", *small, "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr[-2000:]
    table = pd.read_csv(tmp_path / "core.csv")
    assert len(table) == 6 and set(table["part"]) == {"both", "forward", "backward"}
    assert set(table["channels"]) == {"1", "3+depth"} and (table["ms"] > 0).all()


def test_candidates_take_turns_after_a_warm_up():
    called = []

    def candidate(name):
        def run():
            called.append(name)
            return float(len(called))

        return run

    seconds = core.interleave({"a": candidate("a"), "b": candidate("b")}, 2)
    assert called == ["a", "b", "a", "b", "a", "b"] and seconds == {"a": [3.0, 5.0], "b": [4.0, 6.0]}
    assert core.median_ms(seconds["a"]) == pytest.approx(4000.0)

import pandas as pd

from benchmarks import core
from tests.helpers.command import program_here


def test_runs_small(tmp_path):
    small = ["--counts", "300", "--sizes", "64x48", "--channels", "1", "3+depth", "--repetitions", "2"]
    run = program_here(core.main, tmp_path, "core", *small, "--out", str(tmp_path))
    assert run.returncode == 0, run.stderr[-2000:]
    table = pd.read_csv(tmp_path / "core.csv")
    assert set(table["candidate"]) == {"cpu", "cpu forward", "cpu backward"}
    whole = table[table["candidate"] == "cpu"].set_index("channels")
    assert (whole["cpu_ratio"] == 1).all() and whole.loc["3+depth", "most_ratio"] == 1 != whole.loc["1", "most_ratio"]
    assert (table["ms"] > 0).all()

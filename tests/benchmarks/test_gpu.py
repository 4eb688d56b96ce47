import json

import pytest

from benchmarks import gpu
from tdgbench.splats.backends import load_backend
from tests.helpers.command import program_here
from tests.helpers.configs import SMALL


def test_runs_small_on_the_cpu(tmp_path, data_root):
    """Where Warp is installed; a backend that cannot run is a reason in the file."""
    reason = load_backend("warp").why_not()
    if reason is not None:
        pytest.skip(reason)
    overrides = [*SMALL, f"data.root={data_root}", "prior=synthetic", "scene=turntable", "budget.iterations=4"]
    options = ["--methods", "tdg", "--budgets", "demo", "--repetitions", "2", "--no-tests", "--out", str(tmp_path)]
    run = program_here(gpu.main, tmp_path, "gpu", *overrides, *options)
    assert run.returncode == 0, run.stderr[-2000:]
    found = json.loads((tmp_path / "gpu.json").read_text())
    assert found["checks"]["warp"]["reason"] == "" and found["checks"]["warp"]["gradients"] < 1e-5
    (row,) = (row for row in found["trainings"] if row["backend"] == "warp")
    assert row["equal_bytes"] and [set(one["model"]) for one in row["runs"]] == [set(row["runs"][0]["model"])] * 2
    assert all(one["seconds"] > 0 and one["psnr_db"] > 5 for one in row["runs"])
    assert any("Rasterize" in step["operation"] for step in found["profiles"]["warp, tdg"])
    assert "equal bytes" in run.stdout

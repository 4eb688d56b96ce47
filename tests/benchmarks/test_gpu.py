import json
import sys
from types import SimpleNamespace

import pytest
import torch

from benchmarks.gpu import __main__ as gpu
from benchmarks.gpu import measure
from tdgbench.children import Ended
from tdgbench.splats.backends import load_backend
from tests.helpers.backends import need
from tests.helpers.command import program_here
from tests.helpers.configs import SMALL


def of(tmp_path, *words, status=0):
    run = program_here(gpu.main, tmp_path, "gpu", *words, "--no-tests", "--out", str(tmp_path / "out"))
    assert run.returncode == status, run.stderr[-2000:]
    return json.loads((tmp_path / "out" / "gpu.json").read_text()), run.stdout


@pytest.mark.slow
def test_runs_small_on_the_cpu(tmp_path, data_root):
    """Where Warp is installed; a backend that cannot run is a reason in the file."""
    need("warp")
    overrides = [*SMALL, f"data.root={data_root}", "scene=turntable", "budget.iterations=4"]
    options = ["--methods", "tdg", "--budgets", "demo", "--repetitions", "2"]
    found, printed = of(tmp_path, *overrides, *options)
    assert found["checks"]["warp"]["reason"] == "" and found["checks"]["warp"]["gradients"] < 1e-5
    row, other = found["trainings"]
    assert row["equal_bytes"] and [set(one["model"]) for one in row["runs"]] == [set(row["runs"][0]["model"])] * 2
    assert all(one["seconds"] > 0 and one["psnr_db"] > 5 for one in row["runs"])
    profile = found["profiles"]["warp, tdg, demo"]
    assert any("Rasterize" in step["operation"] for step in profile["operations"])
    assert profile["launches"] is None or torch.cuda.is_available()
    assert "scene: orbit, a built-in scene" in printed and "equal bytes" in printed
    if load_backend("cuda").why_not() is not None:
        assert "n/a" in other["runs"][0] and other["equal_bytes"] is None


def test_what_has_no_time_is_not_available(tmp_path):
    found, printed = of(tmp_path, "--minutes", "0.01", status=1)
    assert len(found["trainings"]) == 8 and len(found["profiles"]) == 4
    assert all("n/a" in run for row in found["trainings"] for run in row["runs"])
    assert "there was no time for it" in printed


@pytest.fixture
def measurement(tmp_path):
    args = SimpleNamespace(out=tmp_path, minutes=10.0, scene=(), overrides=[], repetitions=3)
    return measure.Measurement(args)


def test_without_a_backend_no_time_goes_to_tests(measurement):
    measurement.found["checks"] = {"warp": {"reason": "it is not installed"}}
    assert measurement._tests([])["n/a"] == "no backend has passed its check"


def test_a_part_that_fails_loses_nothing(measurement):
    """A child that crashes after its first repetition; then a training that raises."""
    measurement.found["checks"] = {"warp": {"reason": ""}}
    code = 'print(\'{"model": {}, "seconds": 1.0}\', flush=True); import os; os.abort()'
    real = measure.run_limited
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "run_limited", lambda command, *rest: real([sys.executable, "-c", code], *rest))
        measurement._train("warp", "tdg", "lean", 0.5)
    (row,) = json.loads(measurement.file.read_text())["trainings"]
    assert row["runs"][0]["seconds"] == 1.0 and row["equal_bytes"] is None and len(row["runs"]) == 3
    assert [run["n/a"] for run in row["runs"][1:]] == ["it ended by signal SIGABRT"] * 2
    (failed,) = measurement._part("profile", 0.5, overrides=["method=none_such"])
    assert failed["n/a"].startswith("it ended by status 1: ")


@pytest.mark.slow
def test_tests_are_counted(measurement):
    found = measurement._tests(["-m", "not slow"], "tests/test_ply.py")
    assert found["passed"] >= 1 and found["failed"] == [] and found["ended"] == "whole"


def test_failures_have_their_names():
    """With xdist, which writes outcomes before names, and without."""
    out = "tests/a.py::b[x y] FAILED [50%]\n[gw1] [99%] ERROR tests/c.py::d \nFAILED tests/a.py::b[x y] - assert 0\n"
    out += "[gw0] [100%] PASSED tests/a.py::e \n"
    found = measure.counts_of(Ended(1, out, ""))
    assert found == {"passed": 1, "skipped": 0, "failed": ["tests/a.py::b[x y]", "tests/c.py::d"], "ended": "whole"}

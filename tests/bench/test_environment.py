import json
import subprocess
import sys

from tdgbench.bench.environment import HASHED, code_version, describe_environment
from tests.helpers.paths import ROOT


def test_describes_the_machine():
    described = describe_environment()
    json.dumps(described)
    assert described["packages"]["numpy"] and described["cpu"] and described["cores"] >= 1
    assert described["simd_lanes"] in (8, 16)


def test_the_code_that_trains_and_scores_is_hashed():
    """What set-up and scores import makes a cell run again when it changes, but for the choice of files and options."""
    program = "import sys, tdgbench.bench.setup, tdgbench.bench.scores as _; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    modules = [name for name in run.stdout.split() if name.split(".")[0] in ("tdgbench", "methods")]
    hashed = tuple(name.removesuffix(".py").replace("/", ".") for name in HASHED)
    bookkeeping = (
        "backend_check commit failures options signature cells children files resources signals tensors terminal text"
    )
    others = {name.removeprefix("tdgbench.bench.").removeprefix("tdgbench.") for name in modules
              if not name.startswith(hashed)}  # fmt: skip
    assert {name.split(".")[0] for name in others} <= {"tdgbench", "bench", *bookkeeping.split()}
    assert "cells.renders" not in others
    assert all((ROOT / name).exists() for name in HASHED)


def test_a_plug_in_elsewhere_is_part_of_the_code(tmp_path, monkeypatch):
    """Its module is hashed; tdgbench's own, and those of installed packages, make no difference."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "a_plug_in.py").write_text("class Mine:\n    pass\n")
    __import__("a_plug_in")
    config = {"method": {"method": {"_target_": "a_plug_in.Mine", "inner": {"_target_": "torch.nn.ReLU"}}}}
    before = code_version(config)
    assert before == code_version(config) != code_version()
    (tmp_path / "a_plug_in.py").write_text("class Mine:\n    more = True\n")
    assert code_version(config) != before
    assert code_version({"method": {"_target_": "methods.gaussian_splatting.GaussianSplatting"}}) == code_version()

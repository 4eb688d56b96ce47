import json
import subprocess
import sys
from pathlib import Path

from tdgbench.bench.environment import HASHED, code_version, describe_environment
from tests.helpers.paths import ROOT


def test_describes_the_machine():
    described = describe_environment()
    json.dumps(described)
    assert described["packages"]["numpy"] and described["cpu"] and described["cores"] >= 1
    assert described["simd_lanes"] in (8, 16)


def test_the_code_that_sets_a_training_up_is_hashed():
    """Packages whose change must run a cell again: all of tdgbench that a set-up imports, but for its bookkeeping."""
    program = "import sys, tdgbench.bench.setup; print(*(name for name in sys.modules if name.startswith('tdgbench.')))"
    run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    packages = {name.split(".")[1] for name in run.stdout.split()}
    bookkeeping = {"bench", "cells", "files", "resources", "text", "terminal", "signals", "children", "ply", "tensors"}
    assert packages - bookkeeping <= {Path(name).name for name in HASHED}
    assert "tdgbench/bench/setup.py" in HASHED
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

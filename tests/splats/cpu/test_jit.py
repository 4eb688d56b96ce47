import os
import subprocess
import sys

import pytest

from tdgbench.splats.cpu import jit
from tests.conftest import ROOT


def test_lanes_can_be_forced(monkeypatch):
    monkeypatch.setenv("TDGBENCH_LANES", "8")
    assert jit.lanes() == 8
    monkeypatch.setenv("TDGBENCH_LANES", "12")
    with pytest.raises(ValueError, match="TDGBENCH_LANES is '12'"):
        jit.lanes()


def test_the_cache_follows_the_sources_and_the_lanes(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    before = jit.cache_dir()
    assert before.is_relative_to(tmp_path)
    monkeypatch.setenv("TDGBENCH_LANES", "8" if jit.lanes() == 16 else "16")
    assert jit.cache_dir() != before
    monkeypatch.delenv("TDGBENCH_LANES")
    monkeypatch.setattr(jit, "_fingerprint", lambda: "other")
    assert jit.cache_dir() != before


def test_two_processes_may_compile_at_once(tmp_path):
    code = (
        "import torch; from tests.conftest import random_gaussians, turned_camera;"
        "from tdgbench.splats import rasterization;"
        "image = rasterization(*random_gaussians(50, 0, None, 1), *turned_camera(20, 20), 20, 20)[0];"
        "print(image.double().sum().item())"
    )
    env = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(ROOT)}
    start = [
        subprocess.Popen(
            [sys.executable, "-c", code], env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(2)
    ]
    results = [process.communicate(timeout=300) for process in start]
    assert all(process.returncode == 0 for process in start), results
    third = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=300)
    assert results[0][0] == results[1][0] == third.stdout != ""
    assert list(tmp_path.rglob("*.nbi"))

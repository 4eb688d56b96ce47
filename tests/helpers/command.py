"""Run `tdgbench` in a separate process, as a user does."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.helpers.paths import ROOT


def command(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Outcome of a run whose results go to `tmp_path`/results."""
    return tdgbench(tmp_path, *arguments, f"results={tmp_path / 'results'}")


def tdgbench(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Outcome of `python -m tdgbench` in the folder `tmp_path`."""
    variables = {"PYTHONPATH": str(ROOT), "TORCH_HOME": str(tmp_path / "torch"), "COLUMNS": "200"}
    return subprocess.run(
        [sys.executable, "-m", "tdgbench", *arguments],
        cwd=tmp_path, env={**os.environ, **variables}, capture_output=True, text=True, timeout=600,
    )  # fmt: skip

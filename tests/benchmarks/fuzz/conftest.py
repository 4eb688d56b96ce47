from __future__ import annotations

import os

import pytest

from benchmarks.fuzz.case import Programs
from benchmarks.fuzz.child import Limits, tree_megabytes
from benchmarks.fuzz.suite import Suite
from tdgbench.__main__ import main
from tdgbench.tools import TOOLS


@pytest.fixture
def suite(tmp_path) -> Suite:
    """A suite without results."""
    programs = Programs(main, TOOLS["verify"].run)
    here = round(tree_megabytes(os.getpid()))  # a fork begins with the memory of this process
    return Suite(programs, tmp_path / "scratch", Limits(seconds=20, megabytes=here + 1500), results=False)

from __future__ import annotations

import pytest

import tdgbench.__main__
import tdgbench.verify
from tdgbench.experiments.measure.fuzz.case import Programs
from tdgbench.experiments.measure.fuzz.child import Limits
from tdgbench.experiments.measure.fuzz.suite import Suite


@pytest.fixture
def suite(tmp_path) -> Suite:
    """A suite without results."""
    programs = Programs(tdgbench.__main__.main, tdgbench.verify.main)
    return Suite(programs, tmp_path / "scratch", Limits(seconds=20, megabytes=1500), results=False)

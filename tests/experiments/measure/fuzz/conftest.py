from __future__ import annotations

import pytest

from tdgbench.__main__ import main
from tdgbench.experiments.measure.fuzz.case import Programs
from tdgbench.experiments.measure.fuzz.child import Limits
from tdgbench.experiments.measure.fuzz.suite import Suite
from tdgbench.tools import TOOLS


@pytest.fixture
def suite(tmp_path) -> Suite:
    """A suite without results."""
    programs = Programs(main, TOOLS["verify"].run)
    return Suite(programs, tmp_path / "scratch", Limits(seconds=20, megabytes=1500), results=False)

"""Cells that the viewer's tests look at; only to be read."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def tdg_folder(small_results) -> Path:
    """A cell of TDg on a gray scene with temperatures."""
    return small_results / "cells" / "tdg" / "synthetic" / "turntable" / "colmap" / "seed0"


@pytest.fixture(scope="session")
def msmg_folder(small_results) -> Path:
    """A cell of MSMG, which has an RGB model, on the same scene."""
    return small_results / "cells" / "msmg" / "synthetic" / "turntable" / "colmap" / "seed0"


@pytest.fixture(scope="session")
def colour_folder(small_results) -> Path:
    """A cell of TDg on a pseudo-colour scene."""
    return small_results / "cells" / "tdg" / "synthetic" / "orbit" / "colmap" / "seed0"

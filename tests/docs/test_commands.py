"""The trainings that README and tutorial show have options that exist."""

from __future__ import annotations

import re
import shlex

import pytest

from tdgbench.bench.options import check_options
from tests.helpers.configs import config
from tests.helpers.paths import ROOT

COMMAND = re.compile(r"^(?:\| `)?tdgbench ((?:-m )?[^`\n]*=[^`\n]*)", re.MULTILINE)
TRAININGS = sorted(
    {line for page in ("README.md", "docs/tutorial.md") for line in COMMAND.findall((ROOT / page).read_text("utf-8"))}
)


@pytest.mark.parametrize("line", TRAININGS)
def test_trainings_compose(line):
    overrides = [re.sub(r"=([\w.]+),.*", r"=\1", word) for word in shlex.split(line) if word != "-m"]
    check_options(config(*overrides))


def test_they_are_found():
    assert len(TRAININGS) > 12 and any("seed=0,1,2" in line and "tdg,msmg" in line for line in TRAININGS)

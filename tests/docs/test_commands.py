"""The trainings that README, tutorial and commands page show have options that exist."""

from __future__ import annotations

import re
import shlex

import pytest

from tdgbench.bench.options import check_options
from tdgbench.tools import TOOLS
from tests.helpers.configs import config
from tests.helpers.paths import ROOT

COMMAND = re.compile(r"^(?:\| `)?tdgbench ((?:-m )?[^-`\n][^`\n]*=[^`\n]*)", re.MULTILINE)
PAGES = ("README.md", "docs/tutorial.md", "docs/commands.md")
TEXT = "\n".join((ROOT / page).read_text("utf-8") for page in PAGES).replace("\\\n", "")
COMMANDS = set(COMMAND.findall(TEXT))
TRAININGS = sorted(line for line in COMMANDS if line.split()[0] not in TOOLS)


@pytest.mark.parametrize("line", TRAININGS)
def test_trainings_compose(line):
    overrides = [re.sub(r"=([\w.]+),.*", r"=\1", word) for word in shlex.split(line) if word != "-m"]
    check_options(config(*overrides))


def test_they_are_found():
    assert len(TRAININGS) > 12 and any("seed=0,1,2" in line and "tdg,msmg" in line for line in TRAININGS)

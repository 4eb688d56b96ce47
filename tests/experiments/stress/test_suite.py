"""The suite, case by case, on every available backend: the observation meets the expectation."""

from __future__ import annotations

from pathlib import Path

import pytest

from tdgbench.experiments.stress.case import judge
from tdgbench.experiments.stress.suite import all_cases, backends, run_suite
from tests.helpers.configs import config

EXPECTED = config("+experiment=stress", "data.root=unused")
NAMES = [f"{case.family}: {case.name}" for case in all_cases(EXPECTED, Path("unused"))]


@pytest.fixture(scope="module")
def cases(data_root, tmp_path_factory):
    cfg = config("+experiment=stress", f"data.root={data_root}")
    return all_cases(cfg, tmp_path_factory.mktemp("stress"))


@pytest.mark.parametrize("backend", backends())
@pytest.mark.parametrize("index", range(len(NAMES)), ids=NAMES)
def test_case(cases, index, backend):
    case = cases[index]
    verdict = judge(case, backend)
    assert verdict.passed, f"expected {verdict.expected}, observed {verdict.seen}"


def test_there_are_119_cases_with_different_names():
    assert len(NAMES) == len(set(NAMES)) == 119
    families = {name.split(":")[0] for name in NAMES}
    assert families == {"geometry", "appearance", "losses", "gradients", "training", "determinism"}


def test_a_choice_of_cases(data_root):
    reported = []
    table = run_suite(config("+experiment=stress", f"data.root={data_root}"), "opacity 0", reported.append)
    assert list(table["case"]) == ["opacity 0"] * len(table) and len(reported) == len(table) == len(backends())
    with pytest.raises(ValueError, match="no stress case has 'nonsense'"):
        run_suite(config("+experiment=stress", f"data.root={data_root}"), "nonsense", reported.append)

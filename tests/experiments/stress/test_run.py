"""The suite, case by case, on every available backend: the observation meets the expectation."""

from __future__ import annotations

import pandas as pd
import pytest

from tdgbench.bench.options import OptionError
from tdgbench.experiments.stress import clouds
from tdgbench.experiments.stress.case import Case, UnexpectedError, run_case
from tdgbench.experiments.stress.run import Stress, all_cases, backends_of
from tdgbench.splats.backends import fast_backends
from tests.helpers.configs import config

CASES = all_cases(config("+experiment=stress", "data.root=unused"))
RUNS = [(index, backend) for index, case in enumerate(CASES) for backend in backends_of(case)]


@pytest.fixture(scope="module")
def cases(data_root):
    return all_cases(config("+experiment=stress", f"data.root={data_root}"))


@pytest.mark.parametrize(("index", "backend"), RUNS, ids=[f"{CASES[i].family}: {CASES[i].name}-{b}" for i, b in RUNS])
def test_case(cases, index, backend):
    result = run_case(cases[index], backend)
    assert result["passed"], f"expected {result['expected']}, observed {result['seen']}"


def test_there_are_102_cases_with_different_names():
    assert len(CASES) == len({(case.family, case.name) for case in CASES}) == 102
    families = {"geometry", "appearance", "losses", "training", "determinism"}
    assert {case.family for case in CASES} == families


def test_a_choice_of_cases(tmp_path, data_root):
    def table(words, *more):
        options = f"data.root={data_root}", f"results={tmp_path}", f"study.cases='{words}'"
        Stress().run(config("+experiment=stress", *options, *more))
        return pd.read_csv(tmp_path / "stress" / "stress.csv")

    assert list(table("opacity 0")["case"]) == ["opacity 0"] * len(fast_backends())
    assert list(table("opacity 0", "backend=cpu")["backend"]) == ["cpu"]
    with pytest.raises(OptionError, match=r"study\.cases=nonsense: no case has this"):
        table("nonsense")


def surprise(_backend):
    raise UnexpectedError("it is not so")


def test_table_and_status(tmp_path, data_root, capsys, monkeypatch):
    cfg = config("+experiment=stress", f"data.root={data_root}", f"results={tmp_path}", "study.cases=appearance")
    Stress().run(cfg)
    table = pd.read_csv(tmp_path / "stress" / "stress.csv")
    assert len(table) >= 5 and table["passed"].all()
    assert "0 surprises" in capsys.readouterr().out
    monkeypatch.setattr(clouds, "cases", lambda: [Case("appearance", "opacity", "so", surprise)])
    with pytest.raises(SystemExit):
        Stress().run(cfg)
    printed = capsys.readouterr().out
    assert "SURPRISE" in printed and "expected so" in printed and f"{len(fast_backends())} surprises" in printed

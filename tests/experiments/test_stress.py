"""The stress suite, case by case, on every available backend; what it sees, it says."""

from __future__ import annotations

import math

import pandas as pd
import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from tdgbench.bench.backend_check.compare import BackendErrors
from tdgbench.bench.options import OptionError
from tdgbench.experiments.stress import clouds
from tdgbench.experiments.stress.case import Case, Raises, UnexpectedError, require, require_close, run_case
from tdgbench.experiments.stress.run import Stress, all_cases, backends_of
from tdgbench.experiments.stress.training import _budgets, check_same_bytes, train_small
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


def test_the_case_of_opacity_resets_makes_300(data_root):
    cfg = config("+experiment=stress", f"data.root={data_root}")
    changes = next(changes for name, _, changes in _budgets(cfg) if name == "300 opacity resets")
    for name, value in changes.items():
        OmegaConf.update(cfg.budget, name, value)
    budget = instantiate(cfg.budget)
    assert sum(budget.density.is_reset(i, budget.iterations) for i in range(1, budget.iterations)) == 300


def test_there_are_174_cases_with_different_names():
    assert len(CASES) == len({(case.family, case.name) for case in CASES}) == 174
    families = {"geometry", "appearance", "losses", "training", "determinism", "fields", "training of fields"}
    assert {case.family for case in CASES} == families


def test_a_choice_of_cases_has_a_table(tmp_path, data_root, capsys):
    def table(words, *more):
        options = f"data.root={data_root}", f"results={tmp_path}", f"study.cases='{words}'"
        Stress().run(config("+experiment=stress", *options, *more))
        return pd.read_csv(tmp_path / "stress" / "stress.csv")

    found = table("opacity 0")
    assert list(found["case"]) == ["opacity 0"] * len(fast_backends()) and found["passed"].all()
    assert "0 surprises" in capsys.readouterr().out
    assert list(table("opacity 0", "backend=cpu")["backend"]) == ["cpu"]
    with pytest.raises(OptionError, match=r"study\.cases=nonsense: no case has this"):
        table("nonsense")


def fail(error):
    raise error


def test_a_surprise_is_told_and_the_status_is_1(tmp_path, data_root, capsys, monkeypatch):
    surprise = Case("appearance", "opacity", "so", lambda backend: fail(UnexpectedError("it is not so")))
    monkeypatch.setattr(clouds, "cases", lambda: [surprise])
    with pytest.raises(SystemExit):
        Stress().run(config("+experiment=stress", f"data.root={data_root}", f"results={tmp_path}", "study.cases=app"))
    printed = capsys.readouterr().out
    assert "SURPRISE" in printed and "expected so" in printed and f"{len(fast_backends())} surprises" in printed


def test_errors_within_and_beyond_what_is_allowed():
    tolerances = BackendErrors(1e-3, 1e-2)
    assert require_close(BackendErrors(5e-4, 1e-3), tolerances) == "image 5.0e-04; gradients 1.0e-03"
    for errors in (BackendErrors(0.0, 0.02), BackendErrors(0.02, 0.0), BackendErrors(math.nan, 0.0)):
        with pytest.raises(UnexpectedError):
            require_close(errors, tolerances)


@pytest.mark.parametrize(
    ("expected", "act", "passed"),
    [
        (Raises("ValueError", "broken"), lambda: fail(ValueError("it is broken")), True),
        (Raises("ValueError", "broken"), lambda: fail(TypeError("it is broken")), False),
        (Raises("ValueError", "broken"), lambda: fail(ValueError("something else")), False),
        (Raises("ValueError", "broken"), lambda: "nothing happened", False),
        ("so", lambda: "it is so", True), ("so", lambda: require(False, "three"), False),
        ("so", lambda: fail(ValueError("no")), False),
    ],
)  # fmt: skip
def test_a_case_passes_if_it_does_what_is_expected(expected, act, passed):
    assert run_case(Case("family", "name", expected, lambda backend: act()), "cpu")["passed"] == passed


@pytest.fixture
def small(data_root):
    return config("+experiment=stress", f"data.root={data_root}", "budget.iterations=9")


def test_other_bytes_on_the_cpu_are_a_surprise(small):
    seeds = iter(range(5))

    def train():
        small.seed = next(seeds) % 2
        return train_small(small, "cpu")[0]

    with pytest.raises(UnexpectedError, match="different results"):
        check_same_bytes(train)

import math

import pytest

from tdgbench.bench.backend_check.compare import BackendErrors
from tdgbench.experiments.stress.case import Case, Raises, UnexpectedError, require, require_close, run_case


def verdict(expected, act):
    return run_case(Case("family", "name", expected, lambda backend: act()), "cpu")


def fail(error):
    raise error


def test_errors_within_and_beyond_what_is_allowed():
    tolerances = BackendErrors(1e-3, 1e-2)
    assert require_close(BackendErrors(5e-4, 1e-3), tolerances) == "image 5.0e-04; gradients 1.0e-03"
    for errors in (BackendErrors(0.0, 0.02), BackendErrors(0.02, 0.0), BackendErrors(math.nan, 0.0)):
        with pytest.raises(UnexpectedError):
            require_close(errors, tolerances)
    raised = verdict("finite", lambda: fail(ValueError("no")))
    assert not raised["passed"] and raised["seen"] == "ValueError: no"


def test_a_named_error_is_that_error():
    expected = Raises("ValueError", "broken")
    assert verdict(expected, lambda: fail(ValueError("it is broken")))["passed"]
    assert not verdict(expected, lambda: fail(TypeError("it is broken")))["passed"]
    assert not verdict(expected, lambda: fail(ValueError("something else")))["passed"]
    assert not verdict(expected, lambda: "nothing happened")["passed"]


def test_a_sentence_holds_until_its_check_fails():
    assert verdict("so", lambda: "it is so")["passed"]
    require(True, "three")
    with pytest.raises(UnexpectedError, match="three"):
        require(False, "three")
    failed = verdict("so", lambda: require(False, "three"))
    assert not failed["passed"] and failed["seen"] == "UnexpectedError: three"

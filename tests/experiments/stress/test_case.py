import math

import pytest

from tdgbench.experiments.stress.case import Case, Close, Observed, Raises, UnexpectedError, require, run_case


def verdict(expected, act):
    return run_case(Case("family", "name", expected, lambda backend: act()), "cpu")


def fail(error):
    raise error


def test_errors_within_and_beyond_what_is_allowed():
    close = Close(1e-3, 1e-2)
    good = verdict(close, lambda: Observed(numbers={"image": 5e-4, "gradients": 1e-3}))
    assert good.passed and good.seen == "image 5.0e-04; gradients 1.0e-03"
    assert not verdict(close, lambda: Observed(numbers={"image": 0.0, "gradients": 0.02})).passed
    lost = verdict(close, lambda: Observed(numbers={"image": math.nan, "gradients": 0.0}))
    assert not lost.passed
    raised = verdict(close, lambda: fail(ValueError("no")))
    assert not raised.passed and raised.seen == "ValueError: no"


def test_a_named_error_is_that_error():
    expected = Raises("ValueError", "broken")
    assert verdict(expected, lambda: fail(ValueError("it is broken"))).passed
    assert not verdict(expected, lambda: fail(TypeError("it is broken"))).passed
    assert not verdict(expected, lambda: fail(ValueError("something else"))).passed
    assert not verdict(expected, lambda: Observed("nothing happened")).passed


def test_a_sentence_holds_until_its_check_fails():
    assert verdict("so", lambda: Observed("it is so")).passed
    require(True, "three")
    with pytest.raises(UnexpectedError, match="three"):
        require(False, "three")
    failed = verdict("so", lambda: require(False, "three"))
    assert not failed.passed and failed.seen == "UnexpectedError: three"

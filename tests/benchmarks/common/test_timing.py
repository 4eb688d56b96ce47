import pytest

from benchmarks.common.timing import interleave, median_ms


def test_candidates_take_turns_after_a_warm_up():
    called = []

    def candidate(name):
        def run():
            called.append(name)
            return float(len(called))

        return run

    seconds = interleave({"a": candidate("a"), "b": candidate("b")}, 2)
    assert called == ["a", "b", "a", "b", "a", "b"] and seconds == {"a": [3.0, 5.0], "b": [4.0, 6.0]}
    assert median_ms(seconds["a"]) == pytest.approx(4000.0)

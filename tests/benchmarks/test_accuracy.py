import pytest

from benchmarks.accuracy import measure_accuracy


@pytest.mark.parametrize("seed", [0, 1])
def test_the_fast_core_is_exact(seed):
    values = dict(measure_accuracy(3000, 160, 120, seed).itertuples(index=False, name=None))
    assert values.pop("same bytes on 1, 2 and 3 threads") == 1.0
    assert values.pop("pixels that rounding could flip, share") < 0.02
    assert values.pop("pixels flipped, share") < 1e-3
    assert values.pop("image, depth, transmittance: largest error") < 5e-6
    assert values and all(value < 1e-5 for value in values.values()), values

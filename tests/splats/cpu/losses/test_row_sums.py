import numpy as np
import pytest

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses.row_sums import difference_sum, row_sum


@kernel()
def all_sums(a, b):
    return row_sum(a), difference_sum(a, b, None, None), difference_sum(a, b, a, b)


@pytest.mark.parametrize("count", [1, 7, 16, 33, 1920])
def test_sums_of_rows_of_any_length(count):
    a, b = np.random.default_rng(count).random((2, count)).astype(np.float32)
    expected = (
        a.sum(dtype=np.float64),
        np.abs(a - b).sum(dtype=np.float64),
        (a * b * np.abs(a - b)).sum(dtype=np.float64),
    )
    assert all_sums(a, b) == pytest.approx(expected, rel=1e-6)

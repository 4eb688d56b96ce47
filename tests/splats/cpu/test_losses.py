"""Kernels of the losses; their values and gradients are those of `tests/training/test_losses.py`."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.losses.minmax import normalise, normalise_gradient
from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient, prepare_target
from tdgbench.splats.cpu.losses.ssim import SIGMA, WINDOW, window
from tdgbench.splats.cpu.simd.reductions import difference_sum, row_sum


def test_gradient_is_a_difference_quotient_and_the_same_on_any_number_of_threads():
    rng = np.random.default_rng(1)
    values, grad = rng.uniform(0, 4, (13, 9)), rng.normal(size=(13, 9)).astype(np.float32)
    results = []
    for threads in (1, 2, 5):
        pool.set_threads(threads)
        out, inverse_range = normalise(values.astype(np.float32), 1e-8)
        results.append(normalise_gradient(grad, out, inverse_range))
    assert all(np.array_equal(results[0], other) for other in results)

    def loss(v):
        return (grad * (v - v.min()) / (v.max() - v.min())).sum()

    direction = rng.normal(size=values.shape)
    quotient = (loss(values + 1e-6 * direction) - loss(values - 1e-6 * direction)) / 2e-6
    assert (results[0] * direction).sum() == pytest.approx(quotient, rel=1e-4)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("masked", [False, True])
def test_a_prepared_image_gives_the_same_bytes(channels, masked):
    rng = np.random.default_rng(3)
    a, b = (rng.random((37, 41, channels)).astype(np.float32) for _ in range(2))
    valid = rng.random((37, 41)) > 0.2 if masked else None
    prepared = prepare_target(b, valid)
    for _ in range(2):
        once = photometric_and_gradient(a, b, 0.8, -0.2, 0.01, valid=valid)
        again = photometric_and_gradient(a, prepared, 0.8, -0.2, 0.01)
        assert once[:3] == again[:3] and once[3].tobytes() == again[3].tobytes()


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


def test_the_window_is_a_truncated_gaussian():
    weights = window()
    assert weights.sum() == pytest.approx(1) and np.array_equal(weights, weights[::-1])
    impulse = np.zeros(41)
    impulse[20] = 1
    filtered = gaussian_filter1d(impulse, SIGMA, truncate=(WINDOW // 2) / SIGMA)
    assert np.allclose(filtered[15:26], weights)

import numpy as np
import pytest

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses.minmax import normalise, normalise_gradient


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

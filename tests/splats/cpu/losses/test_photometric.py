import numpy as np
import pytest

from tdgbench.scoring.metrics.ssim import ssim
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient


@pytest.mark.parametrize("channels", [1, 2, 3])
def test_value_is_the_metric_s_and_gradient_a_difference_quotient(channels):
    rng = np.random.default_rng(channels)
    a, b = rng.random((25, 31, channels)).astype(np.float32), rng.random((25, 31, channels)).astype(np.float32)
    error, value, _, gradient = photometric_and_gradient(a, b, 0.0, 1.0)
    assert error == pytest.approx(np.abs(a - b).mean(), rel=1e-5)
    assert value == pytest.approx(ssim(a, b, "zero"), abs=1e-6)
    for _ in range(5):
        direction = rng.normal(size=a.shape)
        step = 1e-4
        quotient = (ssim(a + step * direction, b, "zero") - ssim(a - step * direction, b, "zero")) / (2 * step)
        assert (gradient * direction).sum() == pytest.approx(quotient, rel=1e-3, abs=1e-6)


def test_same_bytes_on_any_number_of_threads():
    rng = np.random.default_rng(0)
    a, b = rng.random((37, 20, 3)).astype(np.float32), rng.random((37, 20, 3)).astype(np.float32)
    results = []
    try:
        for threads in (1, 2, 3, 64):
            pool.set_threads(threads)
            error, value, _, gradient = photometric_and_gradient(a, b, 0.8, -0.2)
            results.append((error, value, gradient.tobytes()))
    finally:
        pool.set_threads(None)
    assert len(set(results)) == 1

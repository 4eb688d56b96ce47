import numpy as np
import pytest

from tdgbench.scoring.metrics.ssim import ssim
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.losses.photometric import photometric_and_gradient, prepare_target


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

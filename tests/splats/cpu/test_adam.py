import numpy as np

from tdgbench.splats.cpu.adam import write_drift


def test_drift_is_the_sum_over_the_steps_missed():
    period, stride, now, rho = 8, 16, 21, np.float32(0.9)
    coefficients = np.random.default_rng(0).random((period, stride)).astype(np.float32)
    drift = np.zeros(7 * stride, np.float32)
    write_drift(6, now, stride, coefficients, rho, drift)
    for missed in range(7):
        want = sum(coefficients[(now - missed + j) % period] * 0.9**j for j in range(1, missed + 1))
        assert np.allclose(drift[missed * stride : (missed + 1) * stride], want, rtol=1e-6)

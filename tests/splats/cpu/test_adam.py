import numpy as np

from tdgbench.splats.cpu.adam import sum_displacements


def test_displacements_are_the_sums_over_the_deferred_steps():
    period, stride, now, rho = 8, 16, 21, np.float32(0.9)
    coefficients = np.random.default_rng(0).random((period, stride)).astype(np.float32)
    displacements = np.zeros(7 * stride, np.float32)
    sum_displacements(6, now, coefficients, rho, displacements)
    for deferred in range(7):
        want = sum(coefficients[(now - deferred + j) % period] * 0.9**j for j in range(1, deferred + 1))
        assert np.allclose(displacements[deferred * stride : (deferred + 1) * stride], want, rtol=1e-6)

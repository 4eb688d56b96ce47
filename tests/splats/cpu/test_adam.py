import numpy as np

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import adam_step


def test_one_step_by_hand_and_on_any_number_of_threads():
    rng = np.random.default_rng(0)
    parameter, grad = rng.normal(size=(101, 3)).astype(np.float32), rng.normal(size=(101, 3)).astype(np.float32)
    rates = np.array([0.1, 0.2, 0.0], np.float32)
    results = []
    try:
        for threads in (1, 2, 5):
            pool.set_threads(threads)
            p, m, v = parameter.copy(), np.zeros_like(grad), np.zeros_like(grad)
            adam_step([p, grad, m, v], rates / (1 - 0.9), 0.9, 0.999, (1 - 0.999) ** 0.5, 1e-15)
            results.append(p)
    finally:
        pool.set_threads(None)
    assert all(np.array_equal(results[0], other) for other in results)
    assert np.allclose(results[0], parameter - rates * np.sign(grad), atol=1e-5)  # the first step is a sign step

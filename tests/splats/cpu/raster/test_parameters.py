import numpy as np

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.parameters import deviations, opacity_and_log2
from tdgbench.splats.cpu.raster.source import Columns
from tdgbench.splats.cpu.simd.memory import put_column
from tdgbench.splats.cpu.simd.registers import LANES

COUNT = 25 * LANES


@kernel()
def activate_all(rows, logits, log_scales, out):
    for k in range(0, rows.shape[0], LANES):
        opacity, logarithm = opacity_and_log2(logits, rows, k, True)
        s0, s1, s2 = deviations(log_scales, rows, k, True)
        put_column(out, k, 5, 0, opacity)
        put_column(out, k, 5, 1, logarithm)
        put_column(out, k, 5, 2, s0)
        put_column(out, k, 5, 3, s1)
        put_column(out, k, 5, 4, s2)


def test_activations():
    logits = np.linspace(-80, 60, COUNT, dtype=np.float32)
    log_scales = np.random.default_rng(0).uniform(-25, 12, (COUNT, 3)).astype(np.float32)
    out = np.zeros((COUNT, 5), np.float32)
    activate_all(np.arange(COUNT, dtype=np.int32), Columns(logits, 1, 0), Columns(log_scales.reshape(-1), 3, 0), out)
    exact = 1 / (1 + np.exp(-logits.astype(np.float64)))
    assert np.allclose(out[:, 0], exact, rtol=1e-5)
    assert np.allclose(out[:, 1], np.log2(exact), rtol=1e-6, atol=2e-7)
    assert np.allclose(out[:, 2:], np.exp(log_scales.astype(np.float64)), rtol=3e-6)

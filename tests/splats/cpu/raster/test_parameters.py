import numpy as np

from tdgbench.splats.columns import OPACITY_AT, SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.parameters import GATHERED, collect, deviations, opacity_and_log2
from tdgbench.splats.cpu.raster.source import source_of_rows
from tdgbench.splats.cpu.simd.memory import aligned_floats, put_column
from tdgbench.splats.cpu.simd.registers import LANES

COUNT = 25 * LANES


@kernel()
def activate_all(rows, parameters, out):
    gathered = aligned_floats(GATHERED * LANES)
    for k in range(0, rows.shape[0], LANES):
        collect(parameters, rows, k, 1, gathered)
        opacity, logarithm = opacity_and_log2(gathered, True)
        s0, s1, s2 = deviations(gathered, True)
        put_column(out, k, 5, 0, opacity)
        put_column(out, k, 5, 1, logarithm)
        put_column(out, k, 5, 2, s0)
        put_column(out, k, 5, 3, s1)
        put_column(out, k, 5, 4, s2)


def test_activations():
    values = np.zeros((COUNT, 16), np.float32)
    logits = np.linspace(-80, 60, COUNT, dtype=np.float32)
    log_scales = np.random.default_rng(0).uniform(-25, 12, (COUNT, 3)).astype(np.float32)
    values[:, OPACITY_AT], values[:, SCALES_AT : SCALES_AT + 3] = logits, log_scales
    out = np.zeros((COUNT, 5), np.float32)
    source = source_of_rows(values, np.empty((COUNT, 4), np.float32), 0.0, 0.0)
    activate_all(np.arange(COUNT, dtype=np.int32), source.parameters, out)
    exact = 1 / (1 + np.exp(-logits.astype(np.float64)))
    assert np.allclose(out[:, 0], exact, rtol=1e-5)
    assert np.allclose(out[:, 1], np.log2(exact), rtol=1e-6, atol=2e-7)
    assert np.allclose(out[:, 2:], np.exp(log_scales.astype(np.float64)), rtol=3e-6)

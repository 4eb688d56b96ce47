import numpy as np

from tdgbench.splats.columns import COLORS_AT, OPACITY_AT, SCALES_AT
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.parameters import GATHERED, collect, deviations, opacity_and_log2
from tdgbench.splats.cpu.raster.source import source_of_arrays, source_of_rows
from tdgbench.splats.cpu.simd.memory import aligned_floats, load, put_column
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


@kernel()
def collect_all(rows, parameters, colors, out):
    gathered = aligned_floats(GATHERED * LANES)
    for k in range(0, rows.shape[0], LANES):
        collect(parameters, rows, k, colors, gathered)
        for c in range(out.shape[1]):
            put_column(out, k, out.shape[1], c, load(gathered, c * LANES))


def test_rows_and_arrays_are_collected_alike():
    rng = np.random.default_rng(1)
    values = rng.random((90, 32)).astype(np.float32)
    rows = rng.integers(0, 90, 3 * LANES).astype(np.int32)
    parts = [values[:, :3], values[:, 3:7], values[:, SCALES_AT : SCALES_AT + 3], values[:, OPACITY_AT]]
    arrays = [np.ascontiguousarray(part) for part in (*parts, values[:, COLORS_AT : COLORS_AT + 9])]
    for source in (source_of_rows(values, np.empty((90, 4), np.float32), 0.0, 0.0), source_of_arrays(arrays)):
        out = np.zeros((3 * LANES, COLORS_AT + 9), np.float32)
        collect_all(rows, source.parameters, 9, out)
        assert np.array_equal(out, values[rows, : COLORS_AT + 9])


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

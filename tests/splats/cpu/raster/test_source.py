import numpy as np

from tdgbench.splats.columns import COLORS_AT, MEANS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.raster.source import source_of_arrays

F = np.float32


def test_arrays_become_rows():
    rng = np.random.default_rng(0)
    arrays = [rng.random(shape, F) for shape in ((7, 3), (7, 4), (7, 3), (7,), (7, 4, 3))]
    source = source_of_arrays(arrays)
    values, stride, raw = source.parameters
    assert source.count == 7 and stride == 23 and not raw and not source.bounds.raw
    for first, array in zip((MEANS_AT, QUATS_AT, SCALES_AT, OPACITY_AT, COLORS_AT), arrays, strict=True):
        begin = 5 * stride + first
        assert values[begin : begin + array[5].size].tolist() == array[5].reshape(-1).tolist()
    assert source.bounds.values[8:12].tolist() == [*arrays[0][2], arrays[2][2].max()]
    assert source.bounds.tolerance == source.bounds.growth == 0

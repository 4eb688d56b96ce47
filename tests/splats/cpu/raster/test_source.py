import numpy as np

from tdgbench.splats.columns import COLORS_AT, OPACITY_AT, QUATS_AT, SCALES_AT
from tdgbench.splats.cpu.raster.source import source_of_arrays, source_of_rows

F = np.float32


def numbers(columns, i: int, count: int) -> list[float]:
    """The first `count` numbers of Gaussian i."""
    begin = i * columns.stride + columns.first
    return columns.values[begin : begin + count].tolist()


def test_arrays_are_read_where_they_are():
    rng = np.random.default_rng(0)
    arrays = [rng.random(shape, F) for shape in ((7, 3), (7, 4), (7, 3), (7,), (7, 4, 3))]
    source = source_of_arrays(arrays)
    assert source.count == 7 and not source.parameters.raw and source.bounds.axes == 3
    for columns, array in zip(source.parameters[:5], arrays, strict=True):
        assert np.shares_memory(columns.values, array)
        assert numbers(columns, 5, array[0].size) == array[5].reshape(-1).tolist()
    assert source.bounds.means is source.parameters.means and source.bounds.scales is source.parameters.scales


def test_rows_are_read_where_they_are():
    rng = np.random.default_rng(0)
    values, bounds = rng.random((7, 16), F), rng.random((7, 4), F)
    source = source_of_rows(values, bounds, 0.5, 0.25)
    means, quats, scales, opacities, colors, raw = source.parameters
    assert raw and numbers(means, 3, 3) == values[3, :3].tolist()
    assert numbers(quats, 3, 4) == values[3, QUATS_AT : QUATS_AT + 4].tolist()
    assert numbers(scales, 3, 3) == values[3, SCALES_AT : SCALES_AT + 3].tolist()
    assert numbers(opacities, 3, 1) == [values[3, OPACITY_AT]] and numbers(colors, 3, 1) == [values[3, COLORS_AT]]
    assert numbers(source.bounds.means, 2, 3) == bounds[2, :3].tolist()
    assert numbers(source.bounds.scales, 2, 1) == [bounds[2, 3]] and source.bounds.axes == 1
    assert (source.bounds.tolerance, source.bounds.growth) == (0.5, 0.25)

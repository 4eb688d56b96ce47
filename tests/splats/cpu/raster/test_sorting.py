import numpy as np
import pytest

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.sorting import ONE_THREAD_BELOW, sort_by_key


@pytest.mark.parametrize("count", [0, 1, 5000, ONE_THREAD_BELOW + 1001])
@pytest.mark.parametrize("threads", [1, 3])
def test_sort_is_stable_and_right(count, threads):
    rng = np.random.default_rng(0)
    depths = np.round(rng.uniform(0.2, 50, count + 100), 1).astype(np.float32)
    keys, values = depths.view(np.uint32).copy(), np.arange(count + 100, dtype=np.int32)
    spare = [(np.empty_like(keys), np.empty_like(values)) for _ in range(2)]
    half = count // 2
    pieces = [(0, half), (half + 100, count + 100)]  # with a gap
    try:
        pool.set_threads(threads)
        sorted_keys, order = sort_by_key(pieces, keys, values, spare)
    finally:
        pool.set_threads(None)
    given = np.concatenate([values[a:b] for a, b in pieces])
    assert np.array_equal(order, given[np.argsort(depths[given], kind="stable")])
    assert np.array_equal(sorted_keys, depths.view(np.uint32)[order])

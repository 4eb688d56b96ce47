import numpy as np
import pytest

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.sorting import SHORT, Lists, sort_tiles
from tdgbench.splats.cpu.raster.types import TileLists


@pytest.mark.parametrize("counts", [[0], [1, 0, 2], [SHORT, SHORT + 1, 0, 5000, 3], [700] * 40])
@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("far", [50, 1e9])
def test_every_tile_is_sorted_stably(counts, threads, far):
    rng = np.random.default_rng(0)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    total = int(starts[-1])
    depths = np.round(rng.uniform(0.2, 50, total), 1).astype(np.float32)
    depths[::97] = far
    splat_ids, slots = (rng.permutation(total).astype(np.int32) for _ in range(2))
    out = TileLists(starts, np.full(total, -1, np.int32), np.full(total, -1, np.int32))
    pool.set_threads(threads)
    sort_tiles(Lists(depths.view(np.uint32), splat_ids, slots), max(counts), out)
    tile = np.repeat(np.arange(len(counts)), counts)
    order = np.lexsort((np.arange(total), depths, tile))
    assert np.array_equal(out.splat_ids, splat_ids[order]) and np.array_equal(out.slots, slots[order])


def test_depths_that_differ_in_every_bit():
    keys = np.random.default_rng(1).integers(0, 2**32, 3000, dtype=np.uint32)
    ids = np.arange(3000, dtype=np.int32)
    out = TileLists(np.array([0, 3000]), np.empty(3000, np.int32), np.empty(3000, np.int32))
    sort_tiles(Lists(keys, ids, ids), 3000, out)
    assert np.array_equal(out.splat_ids, np.argsort(keys, kind="stable"))

import numpy as np
import pytest

from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.sorting import SHORT, UPPER, sort_tiles
from tdgbench.splats.cpu.raster.types import TileLists


def sorted_pairs(starts, splat_ids, slots, depths):
    """Sort pairs, whose splats have depths; returns ids and slots."""
    pairs = slots.astype(np.uint64) << UPPER | splat_ids.astype(np.uint64)
    out = TileLists(starts, np.full(len(pairs), -1, np.int32), np.full(len(pairs), -1, np.int32))
    sort_tiles(pairs, depths.view(np.uint32), int(np.diff(starts).max()), out)
    return out.splat_ids, out.slots


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
    pool.set_threads(threads)
    found_ids, found_slots = sorted_pairs(starts, splat_ids, slots, depths)
    tile = np.repeat(np.arange(len(counts)), counts)
    order = np.lexsort((np.arange(total), depths[splat_ids], tile))
    assert np.array_equal(found_ids, splat_ids[order]) and np.array_equal(found_slots, slots[order])


def test_depths_that_differ_in_every_bit():
    keys = np.random.default_rng(1).integers(0, 2**32, 3000, dtype=np.uint32)
    ids = np.arange(3000, dtype=np.int32)
    assert np.array_equal(sorted_pairs(np.array([0, 3000]), ids, ids, keys)[0], np.argsort(keys, kind="stable"))

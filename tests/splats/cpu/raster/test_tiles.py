import numpy as np
import pytest
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.tiles import SHORT, TILE, UPPER, sort_tiles
from tdgbench.splats.cpu.raster.types import TileLists
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.splats.cpu.raster.forward_passes import rendered


def test_every_touched_tile_is_listed_from_near_to_far():
    """Brute force: a tile must list each Gaussian that is 1/255 or more at any of its pixels, in the order of depth."""
    width, height = 90, 61
    parameters, camera = random_gaussians(200, 4, None, 1), turned_camera(width, height)
    parameters[2] *= torch.logspace(-1, 0.6, 200)[:, None]
    found = rendered(parameters, camera, width, height)
    tiles_x = -(-width // TILE)
    depths = parameters[0].numpy() @ camera[0][0, 2, :3].numpy() + camera[0][0, 2, 3].numpy()
    listed = set()
    starts = found.tiles.starts
    for tile in range(len(starts) - 1):
        ids = found.splats.gaussian_ids[found.tiles.splat_ids[starts[tile] : starts[tile + 1]]]
        assert np.all(np.diff(depths[ids]) >= 0)
        listed |= {(tile, int(i)) for i in ids}
    needed = set()
    for i in range(200):
        one = [p[i : i + 1].double() for p in parameters]
        one[4] = torch.ones(1, 1, dtype=torch.float64)
        image, _, _ = rasterization(*one, *camera, width, height, backend="reference")
        ys, xs = np.nonzero(image[0, ..., 0].numpy() > 1.001 / 255)
        needed |= {(int(y // TILE * tiles_x + x // TILE), i) for y, x in zip(ys, xs, strict=True)}
    assert needed <= listed
    assert len(listed) < 1.25 * len(needed)  # and the lists are tight


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

import numpy as np
import pytest
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.tiles import ALONE_BELOW, TILE, sort_by_key
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.splats.cpu.raster.lists import lists


@pytest.mark.parametrize("count", [0, 1, 5000, ALONE_BELOW + 1001])
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


def test_every_touched_tile_is_listed_from_near_to_far():
    """Brute force: a tile must list each Gaussian that reaches 1/255 at any of its pixels, in the order of depth."""
    width, height = 90, 61
    parameters, camera = random_gaussians(200, 4, None, 1), turned_camera(width, height)
    parameters[2] *= torch.logspace(-1, 0.6, 200)[:, None]
    found = lists(parameters, camera, width, height)
    tiles_x = -(-width // TILE)
    depths = parameters[0].numpy() @ camera[0][0, 2, :3].numpy() + camera[0][0, 2, 3].numpy()
    listed = set()
    for tile in range(len(found.tile_start) - 1):
        own = found.owners[found.gaussian_of[found.tile_start[tile] : found.tile_start[tile + 1]]]
        assert np.all(np.diff(depths[own]) >= 0)
        listed |= {(tile, int(i)) for i in own}
    needed = set()
    for i in range(200):
        one = [p[i : i + 1].double() for p in parameters]
        one[4] = torch.ones(1, 1, dtype=torch.float64)
        image, _, _ = rasterization(*one, *camera, width, height, backend="reference")
        ys, xs = np.nonzero(image[0, ..., 0].numpy() > 1.001 / 255)
        needed |= {(int(y // TILE * tiles_x + x // TILE), i) for y, x in zip(ys, xs, strict=True)}
    assert needed <= listed
    assert len(listed) < 1.25 * len(needed)  # and the lists are tight


def test_every_pair_has_its_own_slot():
    found = lists(random_gaussians(300, 5, None, 1), turned_camera(50, 50), 50, 50)
    assert len(np.unique(found.slot_of)) == found.count_pairs()
    first, last = found.pairs[found.gaussian_of].T
    assert (first <= found.slot_of).all() and (found.slot_of < last).all()
    assert sum(int(np.diff(found.pairs[a : a + n]).sum()) for a, n in found.kept) == found.count_pairs()

import numpy as np
import pytest
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.tiles import TILE
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


@pytest.mark.parametrize("threads", [1, 3])
def test_gaussians_of_equal_depth_keep_their_order(threads):
    """Three depths only, and lists too long for a sort by insertion."""
    parameters, (view, K) = random_gaussians(4000, 7, None, 1), turned_camera(40, 40)
    parameters[0][:, 2] = torch.tensor([2.0, 3.0, 1.5])[torch.arange(4000) % 3]
    pool.set_threads(threads)
    found = rendered(parameters, (torch.eye(4).expand_as(view), K), 40, 40)
    longest = 0
    for first, last in zip(found.tiles.starts, found.tiles.starts[1:], strict=False):
        ids = found.splats.gaussian_ids[found.tiles.splat_ids[first:last]]
        assert np.array_equal(ids, ids[np.lexsort((ids, parameters[0][ids, 2].numpy()))])
        longest = max(longest, len(ids))
    assert longest > 300


def test_no_two_pairs_share_a_slot():
    found = rendered(random_gaussians(300, 5, None, 1), turned_camera(50, 50), 50, 50)
    assert len(np.unique(found.tiles.slots)) == len(found.tiles.splat_ids)
    first, last = found.splats.pairs[found.tiles.splat_ids].T
    assert (first <= found.tiles.slots).all() and (found.tiles.slots < last).all()
    assert sum(int(np.diff(found.splats.pairs[a : a + n]).sum()) for a, n in found.splat_spans) == len(
        found.tiles.splat_ids
    )

import numpy as np
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.cpu import backend as cpu
from tdgbench.splats.cpu.binning import TILE, sort_by_depth
from tests.conftest import random_gaussians, turned_camera


def test_sort_is_stable_and_right():
    rng = np.random.default_rng(0)
    depths = np.round(rng.uniform(0.2, 50, 5000), 1).astype(np.float32)
    keys, values = depths.view(np.uint32).copy(), np.arange(5000, dtype=np.int32)
    spare_keys, spare_values = np.empty_like(keys), np.empty_like(values)
    sort_by_depth(keys, values, spare_keys, spare_values, 5000)
    assert np.array_equal(spare_values, np.argsort(depths, kind="stable"))


def lists(parameters, camera, width, height):
    means, quats, scales, opacities, colors = (p.numpy() for p in parameters)
    settings = cpu.Settings(
        camera=cpu.pack_camera(camera[0][0], camera[1][0], width, height, 0.2, 1e10, 0.3), width=width, height=height,
        sh_degree=-1, depth_channel=False, background=np.zeros(1, np.float32), absgrad=False,
    )  # fmt: skip
    radii, means2d = np.zeros(len(means), np.int32), np.zeros((len(means), 2), np.float32)
    return cpu._build_lists((means, scales, quats, opacities, colors[:, None]), settings, radii, means2d)


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
        own = found.gaussian_of[found.tile_start[tile] : found.tile_start[tile + 1]]
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


def test_slots_are_a_permutation():
    found = lists(random_gaussians(300, 5, None, 1), turned_camera(50, 50), 50, 50)
    assert np.array_equal(np.sort(found.slot_of), np.arange(len(found.slot_of)))
    owner = np.searchsorted(found.offsets, found.slot_of, side="right") - 1
    assert np.array_equal(owner, found.gaussian_of)

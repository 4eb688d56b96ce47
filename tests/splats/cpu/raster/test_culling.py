import math

import numpy as np
import pytest
import torch

from tdgbench.splats import rasterization
from tdgbench.splats.cpu.raster.culling import cull
from tdgbench.splats.cpu.raster.types import Bounds, pack_camera
from tdgbench.splats.cpu.simd.registers import LANES
from tests.helpers.gaussians import random_gaussians, turned_camera

CUTOFF = np.float32(math.sqrt(2 * math.log(255)))


def candidates_of(means, scales, camera, tolerance=0.0, growth=0.0, raw=False) -> np.ndarray:
    """The candidates of one piece that holds all."""
    count = len(means)
    out = np.full(-(-count // LANES) * LANES, -1, np.int32)
    rows = torch.cat([means, scales.amax(dim=1, keepdim=True)], dim=1).numpy().reshape(-1)
    bounds = Bounds(rows, raw, np.float32(tolerance), np.float32(growth))
    found = cull(0, count, bounds, camera, CUTOFF, out)
    assert (np.diff(out[:found]) > 0).all()
    filled = -(-found // LANES) * LANES
    assert (out[found:filled] == out[found - 1]).all() if found else True
    return out[:found]


@pytest.mark.parametrize("seed", range(4))
def test_every_visible_gaussian_is_a_candidate(seed):
    width, height = 50, 30
    parameters, (views, Ks) = random_gaussians(400, seed, None, 1), turned_camera(width, height)
    means, scales = parameters[0], parameters[2]
    means *= 3  # most are out of sight
    means[::5, 2] *= -1
    scales *= torch.logspace(-2, 1.5, 400)[:, None]
    camera = pack_camera(views[0], Ks[0], width, height, 0.2, 1e10, 0.3)
    found = candidates_of(means, scales, camera)
    _, _, meta = rasterization(*[p.double() for p in parameters], views, Ks, width, height, backend="reference")
    assert set(torch.nonzero(meta["radii"][0]).squeeze(1).tolist()) <= set(found.tolist())
    assert len(found) < 400


def test_tolerance_and_growth_cover_what_may_have_moved():
    width, height = 50, 30
    parameters, (views, Ks) = random_gaussians(400, 7, None, 1), turned_camera(width, height)
    means, scales = parameters[0] * 3, parameters[2]
    camera = pack_camera(views[0], Ks[0], width, height, 0.2, 1e10, 0.3)
    g = torch.Generator().manual_seed(1)
    away = torch.randn(400, 3, generator=g)
    moved = means + 0.3 * away / away.norm(dim=1, keepdim=True)
    grown = scales * 1.5
    exact = set(candidates_of(moved, grown, camera).tolist())
    log_sizes = scales.log()
    allowed = candidates_of(means, log_sizes, camera, 0.3, np.log(1.5) + 1e-5, raw=True)
    assert exact - set(candidates_of(means, scales, camera).tolist())  # without a tolerance some would be missed
    radii = rasterization(moved, parameters[1], grown, *parameters[3:], views, Ks, width, height)[2]["radii"][0]
    assert set(torch.nonzero(radii).squeeze(1).tolist()) <= set(allowed.tolist())

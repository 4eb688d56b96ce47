import numpy as np
import torch

from tdgbench.splats import geometry
from tdgbench.splats.cpu.raster.types import CHANNELS, FIRST_X, FIRST_Y, OPACITY, RADIUS, U_, V_
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.splats.cpu.raster.forward_passes import rendered


def test_splats_hold_the_projection():
    width, height = 60, 44
    parameters, camera = random_gaussians(300, 6, None, 1), turned_camera(width, height)
    parameters[3][:20] = 0.001  # too faint to be drawn
    done = rendered(parameters, camera, width, height)
    rows = np.concatenate([np.arange(a, a + n) for a, n in done.splat_spans])
    splats, ids = done.splats.values[rows], done.splats.gaussian_ids[rows]
    assert (np.diff(ids) > 0).all() and not (ids < 20).any()
    doubles = [p.double() for p in parameters]
    view, K = camera[0][0].double(), camera[1][0].double()
    means2d, _, covariance, _ = geometry.project(*doubles[:3], view, K, width, height, 0.3)
    corners = splats[:, [FIRST_X, FIRST_Y]]
    found = splats[:, [U_, V_]].astype(np.float64) + corners
    error = np.abs(found - means2d[ids].numpy())  # single precision would be 3e-5 px at 600 px
    assert (error <= 0.5001 * np.spacing(np.abs(splats[:, [U_, V_]])) + 1e-12).all()  # rounded once, from doubles
    assert np.allclose(splats[:, OPACITY], parameters[3][ids].numpy(), rtol=1e-6)
    assert np.allclose(splats[:, CHANNELS], parameters[4][ids, 0].numpy(), rtol=1e-6)
    radii = geometry.screen_radii(means2d, covariance, width, height)
    assert np.array_equal(splats[:, RADIUS], radii[ids].numpy())
    assert (corners == np.round(corners)).all() and (corners >= 0).all() and (corners < (width, height)).all()
    cut = 2 * np.log(255 * splats[:, OPACITY])
    half_width = np.sqrt(cut * covariance[ids, 0, 0].numpy())
    left = np.clip(np.ceil(found[:, 0] - half_width - 0.5), 0, None)
    assert (np.abs(corners[:, 0] - left) <= 1).all()


def test_a_faint_gaussian_is_projected_but_not_drawn():
    parameters, camera = random_gaussians(50, 2, None, 1), turned_camera(40, 30)
    parameters[3][:] = 0.001
    done = rendered(parameters, camera, 40, 30)
    assert sum(n for _, n in done.splat_spans) == 0 and len(done.tiles.splat_ids) == 0
    radii = np.concatenate([done.projected.radii[a : a + n] for a, n in done.projected_spans])
    assert (radii > 0).sum() > 10
    assert torch.equal(torch.from_numpy(done.images.transmittance), torch.ones(30, 40))

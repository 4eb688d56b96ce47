import numpy as np
import torch

from tdgbench.splats.columns import COLORS_AT
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.raster.backward import blend_backward
from tdgbench.splats.cpu.raster.forward import forward
from tests.helpers.gaussians import random_gaussians, turned_camera
from tests.splats.cpu.raster.forward_passes import settings_for, source_of


def test_only_gaussians_that_a_pixel_depends_on_get_rows():
    parameters = random_gaussians(500, 3, None, 1)
    parameters[0][::2, 2] = -5  # behind the camera
    (view,), (K,) = turned_camera(40, 30)
    source, settings = source_of(parameters), settings_for((view, K), 40, 30, 1)
    done = forward(source, settings)
    gradient = np.zeros_like(done.images.color)
    gradient[:5] = 1  # of the upper rows only
    rows = blend_backward(source, settings, done, gradient, None, None).rows()
    touched = np.concatenate([rows.arrays.gaussian_ids[a : a + n] for a, n in rows.spans])
    assert 0 < len(touched) < len(np.unique(done.splats.gaussian_ids[done.tiles.splat_ids]))
    assert (touched % 2 == 1).all() and len(set(touched.tolist())) == len(touched)
    values = np.concatenate([rows.arrays.values[a : a + n] for a, n in rows.spans])
    assert np.abs(values[:, COLORS_AT]).min() > 0 and not values[:, COLORS_AT + 1 :].any()


def test_the_same_on_any_number_of_threads():
    parameters, (views, Ks) = random_gaussians(2000, 5, 2, 3), turned_camera(70, 50)
    settings, found = settings_for((views[0], Ks[0]), 70, 50, 3, 2, True), []
    pull = torch.randn(50, 70, 3, generator=torch.Generator().manual_seed(0)).numpy()
    try:
        for threads in (1, 2, 5):
            pool.set_threads(threads)
            source = source_of(parameters)
            done = forward(source, settings)
            rows = blend_backward(source, settings, done, pull, np.ones_like(done.images.depth), None).rows()
            parts = [[array[a : a + n] for array in rows.arrays] for a, n in rows.spans]
            found.append([np.concatenate(column).tobytes() for column in zip(*parts, strict=True)])
    finally:
        pool.set_threads(None)
    assert found[0] == found[1] == found[2]

import numpy as np
import pytest
import torch

from tdgbench.splats.backends import reference
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.parameters import GATHERED, collect
from tdgbench.splats.cpu.raster.projection import footprint_of, screen_radius
from tdgbench.splats.cpu.raster.source import source_of_arrays
from tdgbench.splats.cpu.raster.types import pack_camera
from tdgbench.splats.cpu.simd.memory import aligned_floats, put_column
from tdgbench.splats.cpu.simd.registers import LANES
from tests.helpers.gaussians import random_gaussians, turned_camera

COUNT = 25 * LANES


@kernel()
def project_all(rows, parameters, camera, out):
    gathered = aligned_floats(GATHERED * LANES)
    for k in range(0, rows.shape[0], LANES):
        collect(parameters, rows, k, 1, gathered)
        footprint = footprint_of(gathered, False, camera)
        (x, y, z), (a, b, c) = footprint.point, footprint.covariance
        u, v = x * footprint.rz * camera.fx + camera.cx, y * footprint.rz * camera.fy + camera.cy
        put_column(out, k, 8, 0, u)
        put_column(out, k, 8, 1, v)
        put_column(out, k, 8, 2, a)
        put_column(out, k, 8, 3, b)
        put_column(out, k, 8, 4, c)
        put_column(out, k, 8, 5, footprint.det)
        put_column(out, k, 8, 6, z)
        put_column(out, k, 8, 7, screen_radius(a, c, footprint.det, u, v, camera))


@pytest.mark.parametrize("shape", ["ordinary", "needles"])
def test_agrees_with_the_reference(shape):
    means, quats, scales, opacities, colors = random_gaussians(COUNT, 9, None, 1)
    if shape == "needles":
        scales[:, 0], scales[:, 1:] = 3.0, 1e-4
    (view,), (K,) = turned_camera(64, 48)
    out = np.zeros((COUNT, 8), np.float32)
    source = source_of_arrays([t.numpy() for t in (means, quats, scales, opacities, colors)])
    camera = pack_camera(view, K, 64, 48, 0.2, 1e10, 0.3)
    project_all(np.arange(COUNT, dtype=np.int32), source.parameters, camera, out)
    means2d, _, covariance, z = reference.project(*(t.double() for t in (means, quats, scales, view, K)), 64, 48, 0.3)
    want = torch.cat(
        [means2d, covariance.flatten(1)[:, [0, 1, 3]], torch.linalg.det(covariance)[:, None], z[:, None]], 1
    )
    front = (z > 0.2).numpy()
    got, want = out[front, :7], want.numpy()[front]
    assert np.abs(got - want).max(axis=0)[:2].max() < 1e-3
    assert np.allclose(got[:, 2:], want[:, 2:], rtol=2e-4, atol=1e-4 * np.abs(want[:, 2:5]).max())
    assert np.median(np.abs(got[:, 5] / want[:, 5] - 1)) < 1e-5  # no cancellation in the determinant
    radii = reference._screen_radii(means2d, covariance, 64, 48).numpy()[front]
    assert (out[front, 7].astype(int) != radii).mean() < 0.01

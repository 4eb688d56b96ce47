import numpy as np
import pytest
import torch

from tdgbench.splats import reference
from tdgbench.splats.cpu.backend import pack_camera
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.projection import (
    along_axes,
    camera_point,
    clamped_ray,
    covariance_2d,
    jacobian_rows,
    rotation,
    scaled,
    screen_radius,
)
from tests.conftest import random_gaussians, turned_camera


@kernel()
def project_all(means, quats, scales, camera, out):
    for i in range(means.shape[0]):
        x, y, z = camera_point(i, means, camera)
        rz = np.float32(1) / z
        tx, ty = clamped_ray(x, y, rz, camera)
        r0, r1, r2, _ = rotation(i, quats)
        ja, jb = jacobian_rows(tx, ty, rz, camera)
        p = scaled(along_axes(ja, r0, r1, r2), i, scales)
        q = scaled(along_axes(jb, r0, r1, r2), i, scales)
        a, b, c, det = covariance_2d(p, q, camera[21])
        u, v = camera[12] * x * rz + camera[14], camera[13] * y * rz + camera[15]
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4] = u, v, a, b, c
        out[i, 5], out[i, 6], out[i, 7] = det, z, screen_radius(a, c, det, u, v, camera)


@pytest.mark.parametrize("shape", ["ordinary", "needles"])
def test_agrees_with_the_reference(shape):
    means, quats, scales, _, _ = random_gaussians(400, 9, None, 1)
    if shape == "needles":
        scales[:, 0], scales[:, 1:] = 3.0, 1e-4
    (view,), (K,) = turned_camera(64, 48)
    out = np.zeros((400, 8), np.float32)
    project_all(means.numpy(), quats.numpy(), scales.numpy(), pack_camera(view, K, 64, 48, 0.2, 1e10, 0.3), out)
    means2d, _, covariance, z = reference._project(*(t.double() for t in (means, quats, scales, view, K)), 64, 48, 0.3)
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

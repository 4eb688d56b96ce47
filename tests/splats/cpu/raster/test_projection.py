import numpy as np
import pytest
import torch

from tdgbench.splats.backends import reference
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.camera import pack_camera
from tdgbench.splats.cpu.raster.projection import deviations, footprint, opacity_and_log2, screen_radius
from tdgbench.splats.cpu.raster.source import Columns, source_of_arrays
from tdgbench.splats.cpu.simd.memory import put_column
from tdgbench.splats.cpu.simd.registers import LANES
from tests.helpers.gaussians import random_gaussians, turned_camera

COUNT = 25 * LANES


@kernel()
def project_all(rows, parameters, camera, out):
    for k in range(0, rows.shape[0], LANES):
        seen = footprint(parameters, rows, k, camera)
        (x, y, z), (a, b, c) = seen.point, seen.covariance
        u, v = x * seen.rz * camera.fx + camera.cx, y * seen.rz * camera.fy + camera.cy
        put_column(out, k, 8, 0, u)
        put_column(out, k, 8, 1, v)
        put_column(out, k, 8, 2, a)
        put_column(out, k, 8, 3, b)
        put_column(out, k, 8, 4, c)
        put_column(out, k, 8, 5, seen.det)
        put_column(out, k, 8, 6, z)
        put_column(out, k, 8, 7, screen_radius(a, c, seen.det, u, v, camera))


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


@kernel()
def activate_all(rows, logits, log_scales, out):
    for k in range(0, rows.shape[0], LANES):
        opacity, logarithm = opacity_and_log2(logits, rows, k, True)
        s0, s1, s2 = deviations(log_scales, rows, k, True)
        put_column(out, k, 5, 0, opacity)
        put_column(out, k, 5, 1, logarithm)
        put_column(out, k, 5, 2, s0)
        put_column(out, k, 5, 3, s1)
        put_column(out, k, 5, 4, s2)


def test_activations():
    logits = np.linspace(-80, 60, COUNT, dtype=np.float32)
    log_scales = np.random.default_rng(0).uniform(-25, 12, (COUNT, 3)).astype(np.float32)
    out = np.zeros((COUNT, 5), np.float32)
    activate_all(np.arange(COUNT, dtype=np.int32), Columns(logits, 1, 0), Columns(log_scales.reshape(-1), 3, 0), out)
    exact = 1 / (1 + np.exp(-logits.astype(np.float64)))
    assert np.allclose(out[:, 0], exact, rtol=1e-5)
    assert np.allclose(out[:, 1], np.log2(exact), rtol=1e-6, atol=2e-7)
    assert np.allclose(out[:, 2:], np.exp(log_scales.astype(np.float64)), rtol=3e-6)

import numpy as np
import pytest
import torch

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.harmonics import direction_gradient, view_direction, write_basis
from tdgbench.splats.cpu.raster.types import pack_camera
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.memory import load, store
from tdgbench.splats.cpu.simd.registers import LANES
from tdgbench.splats.harmonics import sh_basis

F = np.float32


@kernel()
def evaluate(directions, degree, pull, values, gradient):
    x, y, z = load(directions, 0), load(directions, LANES), load(directions, 2 * LANES)
    write_basis(x, y, z, degree, values)
    if degree > 0:
        gx, gy, gz = direction_gradient(x, y, z, degree, pull)
        store(gradient, 0, gx)
        store(gradient, LANES, gy)
        store(gradient, 2 * LANES, gz)


def zeros(registers: int) -> np.ndarray:
    out = empty_aligned((registers * LANES,), F)
    out[:] = 0
    return out


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_and_gradient_are_torch_s(degree):
    rng = np.random.default_rng(degree)
    count = (degree + 1) ** 2
    unit = rng.normal(size=(LANES, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    directions, pull, values, gradient = zeros(3), zeros(16), zeros(16), zeros(3)
    directions[:] = unit.T.reshape(-1)
    pull[:] = rng.normal(size=16 * LANES)
    evaluate(directions, degree, pull, values, gradient)
    d = torch.tensor(unit, requires_grad=True)
    want = sh_basis(d, degree)
    assert np.allclose(values.reshape(16, LANES)[:count].T, want.detach().numpy(), atol=1e-6)
    assert not values.reshape(16, LANES)[count:].any()
    if degree > 0:
        (want * torch.from_numpy(pull.reshape(16, LANES)[:count].T.copy()).double()).sum().backward()
        assert np.allclose(gradient.reshape(3, LANES).T, d.grad.numpy(), atol=1e-5)


@kernel()
def directions_from(means, camera, out):
    x, y, z, inverse = view_direction((load(means, 0), load(means, LANES), load(means, 2 * LANES)), camera)
    store(out, 0, x)
    store(out, LANES, y)
    store(out, 2 * LANES, z)
    store(out, 3 * LANES, inverse)


def test_view_direction():
    means, out, view = zeros(3), zeros(4), np.eye(4)
    view[:3, 3] = -1, 2, -3
    camera = pack_camera(view, np.eye(3), 8, 8, 0.2, 1e10, 0.3)
    points = np.random.default_rng(0).normal(size=(LANES, 3)).astype(F)
    means[:] = points.T.reshape(-1)
    directions_from(means, camera, out)
    assert camera.centre == (1, -2, 3)
    away = points - np.array(camera.centre)
    distance = np.linalg.norm(away, axis=1)
    assert np.allclose(out.reshape(4, LANES)[:3].T, away / distance[:, None], atol=1e-6)
    assert np.allclose(out.reshape(4, LANES)[3], 1 / distance, rtol=1e-6)

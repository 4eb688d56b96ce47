import numpy as np
import torch

from tdgbench.splats.backends import reference
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.ewa_gradient import axis_gradient, quaternion_gradient, whitened


@kernel()
def call_whitened(unit, p, q, k, m, eps, det):
    return whitened(unit, p, q, k, m, eps, det)


@kernel()
def call_axis_gradient(y, scale, moments, conic):
    return axis_gradient(y, scale, moments, conic)


@kernel()
def call_quaternion_gradient(unit, per_length, g):
    return quaternion_gradient(unit, per_length, g)


def axes_and_gradient(seed: int, longest: float = 1.0):
    """Scaled axes p, q of an image covariance, its blur, and a gradient (xx, xy, yy) of the inverse's entries."""
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(2, 3))
    axes[:, 0] *= longest
    return axes, 0.3, rng.normal(size=3)


def test_axes_of_an_inverse_covariance():
    for longest in (1.0, 1e3):
        axes, eps, g = axes_and_gradient(0, longest)
        scale = np.array([2.0, 0.5, 1.5])
        unit = axes / scale
        w = torch.tensor(unit, requires_grad=True)
        s = torch.tensor(scale, requires_grad=True)
        a = w * s
        inverse = torch.linalg.inv(a @ a.T + eps * torch.eye(2, dtype=torch.float64))
        (inverse[0, 0] * g[0] + 2 * inverse[0, 1] * g[1] + inverse[1, 1] * g[2]).backward()
        M = inverse.detach().numpy()
        p, q = (tuple(np.float32(x) for x in row) for row in axes)
        det = np.float32(1 / np.linalg.det(axes @ axes.T + eps * np.eye(2)))
        for j in range(3):
            y = call_whitened(
                (np.float32(unit[0, j]), np.float32(unit[1, j])), p, q, (j + 1) % 3, (j + 2) % 3, np.float32(eps), det
            )
            assert np.allclose(y, M @ unit[:, j], rtol=1e-4)  # also along a needle
            moments = tuple(np.float32(x) for x in g)
            conic = (np.float32(M[0, 0]), np.float32(-M[0, 1]), np.float32(M[1, 1]))
            by_u, by_v, by_s = call_axis_gradient(y, np.float32(scale[j]), moments, conic)
            assert np.allclose(by_s, s.grad[j].item(), rtol=1e-3)
            assert np.allclose([by_u * scale[j], by_v * scale[j]], w.grad[:, j].numpy(), rtol=2e-3, atol=1e-6)


def test_quaternion_through_its_normalisation():
    rng = np.random.default_rng(1)
    raw = torch.tensor(rng.normal(size=(1, 4)) * 3, requires_grad=True)
    g = rng.normal(size=(3, 3))
    (reference.rotation_matrices(raw)[0] * torch.from_numpy(g)).sum().backward()
    n = 1 / np.linalg.norm(raw.detach().numpy())
    unit = (raw.detach().numpy()[0] * n).astype(np.float32)
    rows = tuple(tuple(row) for row in g.astype(np.float32))
    got = call_quaternion_gradient(tuple(unit), np.float32(n), rows)
    assert np.allclose(got, raw.grad.numpy()[0], rtol=1e-4, atol=1e-5)
    assert abs(np.dot(got, unit)) < 1e-4  # the length of a quaternion does not matter

import numpy as np
import torch

from tdgbench.splats import reference
from tdgbench.splats.cpu.projection_backward import conic_to_covariance, quaternion_gradient


def test_inverse_of_a_covariance():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(2, 2))
    covariance = root @ root.T + 0.3 * np.eye(2)
    abc = torch.tensor([covariance[0, 0], covariance[0, 1], covariance[1, 1]], requires_grad=True)
    det = abc[0] * abc[2] - abc[1] ** 2
    conic = torch.stack([abc[2], -abc[1], abc[0]]) / det
    g = torch.tensor([0.3, -0.7, 1.1], dtype=torch.float64)
    (conic * g).sum().backward()
    got = conic_to_covariance(*g.numpy().astype(np.float32), *conic.detach().numpy().astype(np.float32))
    assert np.allclose(got, abc.grad.numpy(), rtol=1e-4)


def test_quaternion_through_its_normalisation():
    rng = np.random.default_rng(1)
    raw = torch.tensor(rng.normal(size=(1, 4)) * 3, requires_grad=True)
    g = rng.normal(size=(3, 3))
    (reference.rotation_matrices(raw)[0] * torch.from_numpy(g)).sum().backward()
    n = 1 / np.linalg.norm(raw.detach().numpy())
    unit = (raw.detach().numpy()[0] * n).astype(np.float32)
    rows = [tuple(row) for row in g.astype(np.float32)]
    got = quaternion_gradient(*unit, np.float32(n), *rows)
    assert np.allclose(got, raw.grad.numpy()[0], rtol=1e-4, atol=1e-5)
    assert abs(np.dot(got, unit)) < 1e-4  # the length of a quaternion does not matter

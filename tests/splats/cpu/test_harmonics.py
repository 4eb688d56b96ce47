import numpy as np
import pytest
import torch

from tdgbench.splats.cpu.harmonics import direction_gradient, write_basis
from tdgbench.splats.harmonics import basis


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_basis_and_gradient_are_torch_s(degree):
    rng = np.random.default_rng(degree)
    count = (degree + 1) ** 2
    for _ in range(20):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        d = torch.tensor(direction, requires_grad=True)
        values = basis(d, degree)
        out = np.zeros(16, np.float32)
        write_basis(*direction.astype(np.float32), degree, out)
        assert np.allclose(out[:count], values.detach().numpy(), atol=1e-6) and not out[count:].any()
        if degree > 0:
            pull = rng.normal(size=16).astype(np.float32)
            (values * torch.from_numpy(pull[:count]).double()).sum().backward()
            got = direction_gradient(*direction.astype(np.float32), degree, pull)
            assert np.allclose(got, d.grad.numpy(), atol=1e-5)

import math

import numpy as np
import pytest
import torch

from tdgbench.splats.harmonics import colors_from_sh, num_bases, sh_basis, sh_from_color


def sphere_quadrature(n: int = 12):
    """Directions and weights that integrate polynomials of degree < 2n over the sphere exactly."""
    z, wz = np.polynomial.legendre.leggauss(n)
    phi = np.arange(2 * n) * np.pi / n
    z, phi = np.meshgrid(z, phi, indexing="ij")
    r = np.sqrt(1 - z**2)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=-1).reshape(-1, 3)
    return torch.from_numpy(directions), torch.from_numpy(np.repeat(wz, 2 * n) * np.pi / n)


def test_basis_is_orthonormal():
    directions, weights = sphere_quadrature()
    values = sh_basis(directions, 3)
    assert torch.allclose(values.T @ (weights[:, None] * values), torch.eye(16, dtype=torch.float64), atol=1e-12)


def test_degree_zero_is_the_color():
    color = torch.rand(5, 3)
    assert torch.allclose(0.5 + sh_from_color(color) / (2 * math.pi**0.5), color, atol=1e-6)
    shown = colors_from_sh(sh_from_color(color)[:, None], torch.nn.functional.normalize(torch.randn(5, 3), dim=1), 0)
    assert torch.allclose(shown, color, atol=1e-6)


def test_a_degree_that_does_not_exist():
    with pytest.raises(ValueError, match="sh_degree is 4"):
        num_bases(4)

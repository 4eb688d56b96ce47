"""The kernels are the interpolation in float64, value and gradient, for any number of threads."""

import numpy as np
import pytest
import torch

from tdgbench.fields.hash_grid import HashGrid, interpolated, levels_of
from tdgbench.splats.cpu import pool

SIZES = {"dense": (3, 4, 16, 14), "hashed": (3, 64, 512, 8), "both": (6, 8, 256, 12)}


def grid(size: str) -> HashGrid:
    made = HashGrid(*SIZES[size], torch.Generator().manual_seed(0))
    made.table.data.normal_(generator=torch.Generator().manual_seed(1))
    return made


def positions(count: int = 5000) -> torch.Tensor:
    """Positions in the box, some of them on its sides, edges and corners; float32 holds their products with cells."""
    found = (2**14 * torch.rand(count, 3, generator=torch.Generator().manual_seed(2))).round() / 2**14
    return torch.where(torch.rand(count, 3, generator=torch.Generator().manual_seed(3)) < 0.02, found.round(), found)


def with_gradient(module: HashGrid, at: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    features = module(at)
    weights = torch.randn(features.shape, generator=torch.Generator().manual_seed(4)).to(features)
    (gradient,) = torch.autograd.grad(features, module.table, weights)
    return features.detach(), gradient


@pytest.mark.parametrize("size", SIZES)
def test_value_and_gradient_are_those_of_float64(size):
    at = positions()
    value, gradient = with_gradient(grid(size), at)
    exact, exact_gradient = with_gradient(grid(size).double(), at.double())
    assert (value - exact).abs().max() < 1e-6 * exact.abs().max()
    assert (gradient - exact_gradient).norm() < 1e-6 * exact_gradient.norm()


def test_the_reference_interpolates_between_corners():
    """At a corner the feature is its row; between two corners it is their mean."""
    made = grid("dense").double()
    level = made.levels[0]
    corners = torch.tensor([[0.0, 0, 0], [0.5, 0, 0], [1, 1, 1]], dtype=torch.float64)
    rows = made.table[[0, 2, level.rows - 1]]
    assert torch.allclose(interpolated(corners, made.table, level), rows)
    between = torch.tensor([[0.375, 0, 0]], dtype=torch.float64)  # cells of a quarter
    assert torch.allclose(interpolated(between, made.table, level), made.table[1:3].mean(dim=0))


def test_positions_have_the_gradient_of_finite_differences():
    made = grid("hashed").double()
    at = (0.1 + 0.8 * torch.rand(20, 3, dtype=torch.float64)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: made(x), (at,), eps=1e-9, atol=1e-3)
    at = at.detach().float().requires_grad_()
    made.float()(at).sum().backward()
    assert at.grad.abs().sum() > 0


@pytest.mark.parametrize("size", ["hashed", "both"])
def test_threads_change_no_byte(size):
    results = []
    try:
        for threads in (1, 2, 5):
            pool.set_threads(threads)
            results.append([tensor.numpy().tobytes() for tensor in with_gradient(grid(size), positions(40_000))])
    finally:
        pool.set_threads(None)
    assert results[0] == results[1] == results[2]


def test_gradients_that_are_held_are_not_overwritten():
    """The memory of a gradient is used again, once nobody holds it."""
    made, at = grid("both"), positions()
    first = with_gradient(made, at)[1]
    copy = first.clone()
    second = with_gradient(made, at.flip(1))[1]
    assert torch.equal(first, copy) and not torch.equal(first, second)
    made(at).sum().backward()
    made(at).sum().backward()
    summed = made.table.grad.clone()
    made.table.grad = None
    made(at).sum().backward()
    assert torch.allclose(summed, 2 * made.table.grad)


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), -3.0, 1e30])
def test_positions_out_of_range_read_no_memory_of_others(bad):
    """They are errors of the caller; what they give is arbitrary, and the process goes on."""
    at = torch.full((100, 3), bad)
    for size in SIZES:
        with_gradient(grid(size), at)


def test_levels_grow_from_the_coarsest_to_the_finest():
    levels = levels_of(16, 16, 2048, 2**19)
    assert [level.cells for level in levels[:4]] == [16, 22, 30, 42] and levels[-1].cells == 2048
    ratios = np.divide(*np.array([[level.cells for level in part] for part in (levels[1:], levels[:-1])]))
    assert (np.abs(ratios - 128 ** (1 / 15)) < 0.05).all()
    assert [level.is_dense for level in levels] == [(level.cells + 1) ** 3 <= 2**19 for level in levels]
    assert [level.first for level in levels[1:]] == list(np.cumsum([level.rows for level in levels])[:-1])

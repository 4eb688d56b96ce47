"""Networks in pieces are those of plain torch in float64, value and gradient."""

import copy

import pytest
import torch

from tdgbench.fields.networks import MLP, PIECE, encoded_directions, truncated_exp
from tdgbench.splats.cpu import pool

SHAPES = [((32, 64, 16), False), ((15, 64, 64), True), ((10, 16, 1), False), ((5, 3), False)]


def network(sizes: tuple[int, ...], sigmoid: bool) -> MLP:
    return MLP(sizes, torch.Generator().manual_seed(0), sigmoid)


def run(net: MLP, rows: torch.Tensor) -> list[torch.Tensor]:
    """Return outputs, and the gradients of rows and weights."""
    rows = rows.detach().requires_grad_()
    out = net(rows)
    weights = torch.randn(out.shape, generator=torch.Generator().manual_seed(2)).to(out)
    return [out.detach(), *torch.autograd.grad(out, [rows, *net.weights], weights)]


def inputs(count: int, columns: int) -> torch.Tensor:
    return torch.randn(columns, count, generator=torch.Generator().manual_seed(1)).T  # as the hash grid stores them


@pytest.mark.parametrize("count", [1, 7, PIECE, 2 * PIECE + 100])
@pytest.mark.parametrize("sizes, sigmoid", SHAPES)
def test_value_and_gradient_are_those_of_float64(sizes, sigmoid, count):
    net, rows = network(sizes, sigmoid), inputs(count, sizes[0])
    exact = run(copy.deepcopy(net).double(), rows.double())
    for mine, reference in zip(run(net, rows), exact, strict=True):
        assert mine.shape == reference.shape
        assert (mine - reference).norm() < 2e-6 * reference.norm()


def test_rows_may_be_a_view():
    net, rows = network((15, 64, 64), True), inputs(1000, 16)[:, 1:]
    for mine, reference in zip(run(net, rows), run(copy.deepcopy(net).double(), rows.double()), strict=True):
        assert (mine - reference).norm() < 2e-6 * reference.norm()


def test_threads_change_no_byte(monkeypatch):
    net, rows, results = network((32, 64, 16), False), inputs(3 * PIECE + 5, 32), []
    before = torch.get_num_threads()
    torch.set_num_threads(1)  # as cells run
    try:
        for threads in (1, 2, 3):
            pool.set_threads(threads)
            results.append([tensor.numpy().tobytes() for tensor in run(net, rows)])
    finally:
        pool.set_threads(None)
        torch.set_num_threads(before)
    assert results[0] == results[1] == results[2]


def test_equal_seeds_give_equal_weights():
    first, second = network((8, 4, 2), False), network((8, 4, 2), False)
    assert all(torch.equal(a, b) for a, b in zip(first.weights, second.weights, strict=True))
    other = MLP((8, 4, 2), torch.Generator().manual_seed(1))
    assert not torch.equal(first.weights[0], other.weights[0])


def test_the_exponential_has_its_own_gradient_up_to_its_limit():
    x = torch.tensor([-2.0, 3.0, 20.0], dtype=torch.float64, requires_grad=True)
    truncated_exp(x).sum().backward()
    assert torch.allclose(x.grad, torch.tensor([-2.0, 3.0, 15.0], dtype=torch.float64).exp())


def test_directions_are_orthonormal_functions_of_the_sphere():
    """Their mean products over the sphere, times its area, are the identity; lengths do not matter."""
    directions = torch.randn(400_000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    basis = encoded_directions(directions)
    product = 4 * torch.pi * basis.T @ basis / len(basis)
    assert (product - torch.eye(16, dtype=torch.float64)).abs().max() < 0.03
    assert torch.allclose(basis[:9], encoded_directions(3 * directions[:9]))

"""Steps are torch's where every entry has a gradient; entries without one stay."""

import pytest
import torch

from tdgbench.fields.adam import FieldAdam
from tdgbench.splats.cpu import pool

COUNTS = (3, 8, 37, 600_001)


def steps(optimizer, parameter: torch.Tensor, gradients: list[torch.Tensor]) -> torch.Tensor:
    for gradient in gradients:
        parameter.grad = gradient.to(parameter).clone()
        optimizer.step()
    return parameter.detach()


def random(count: int, number: int = 6, dtype: torch.dtype = torch.float64) -> list[torch.Tensor]:
    stream = torch.Generator().manual_seed(count)
    return [torch.randn(count, generator=stream, dtype=dtype) for _ in range(number)]


def sparse(gradient: torch.Tensor) -> torch.Tensor:
    return torch.where(torch.arange(len(gradient)) % 3 == 1, 0.0, gradient)


@pytest.mark.parametrize("count", COUNTS[:3])
def test_dense_steps_are_those_of_torch(count):
    start, *gradients = random(count)
    mine, theirs = (start.clone().requires_grad_() for _ in range(2))
    steps(FieldAdam([mine], 1e-2), mine, gradients)
    steps(torch.optim.Adam([theirs], 1e-2, eps=1e-15), theirs, gradients)
    assert torch.allclose(mine, theirs, rtol=1e-12)


@pytest.mark.parametrize("count", COUNTS)
def test_kernels_are_the_steps_in_float64_with_some_entries_left_out(count):
    start, *gradients = random(count)
    gradients = [*gradients[:2], *map(sparse, gradients[2:4]), gradients[4]]
    exact, single = start.clone().requires_grad_(), start.float().requires_grad_()
    steps(FieldAdam([exact], 1e-2), exact, gradients)
    steps(FieldAdam([single], 1e-2), single, gradients)
    assert (single - exact).abs().max() < 1e-6


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_entries_without_a_gradient_keep_value_and_moments(dtype):
    start, *gradients = random(37, dtype=dtype)
    parameter = start.clone().requires_grad_()
    optimizer = FieldAdam([parameter], 1e-2)
    before = steps(optimizer, parameter, gradients[:2]).clone()
    moments = [optimizer.state[parameter][name].clone() for name in ("first", "second")]
    after = steps(optimizer, parameter, [sparse(gradients[2])])
    without = sparse(gradients[2]) == 0
    assert torch.equal(after[without], before[without]) and (after != before)[~without].all()
    for name, moment in zip(("first", "second"), moments, strict=True):
        assert torch.equal(optimizer.state[parameter][name][without], moment[without])


def test_state_is_restored_and_threads_change_no_byte():
    start, *gradients = random(600_001, dtype=torch.float32)
    results = []
    try:
        for threads in (1, 3):
            pool.set_threads(threads)
            parameter = start.clone().requires_grad_()
            optimizer = FieldAdam([parameter], 1e-2)
            steps(optimizer, parameter, gradients[:2])
            again = FieldAdam([parameter], 1.0)
            again.load_state_dict(optimizer.state_dict())
            results.append(steps(again, parameter, gradients[2:]).numpy().tobytes())
    finally:
        pool.set_threads(None)
    parameter = start.clone().requires_grad_()
    assert results[0] == results[1] == steps(FieldAdam([parameter], 1e-2), parameter, gradients).numpy().tobytes()

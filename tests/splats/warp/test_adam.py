"""Adam's step by Warp's kernel, against torch in float64: on Warp's CPU device, and on a GPU."""

from typing import NamedTuple, Self

import pytest
import torch

from tdgbench.splats import optimizer as optimizing
from tdgbench.splats.backends import warp
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tests.helpers.gaussians import RATES
from tests.splats.backward_passes import cloud

REASON = warp.BACKEND.why_not()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)]


class Given(NamedTuple):
    """Gradients that are there already."""

    values: torch.Tensor

    def compute(self) -> Self:
        return self


def stepped(device: str, dtype: torch.dtype) -> list[torch.Tensor]:
    """Values and moments, float64 on the CPU, after eight steps; then a step with an infinite gradient is refused."""
    optimizer = Adam(TrainingState(cloud(3, 2, dtype).map(lambda t: t.to(device))), RATES, 2.0)
    optimizer.is_sparse = False
    g, state = torch.Generator().manual_seed(1), optimizer.state
    sizes = 10.0 ** -(torch.arange(state.values.shape[1]) % 16)  # of gradients, by column
    for iteration in range(1, 9):
        gradients = (sizes * torch.randn(state.values.shape, generator=g)).to(state.values)
        bad = optimizer.step(Given(gradients), iteration)
        assert (bad() if callable(bad) else bad) is None
    left = [t.double().cpu().clone() for t in (state.values, state.first, state.second)]
    gradients[5, state.columns_of("quats").start] = torch.inf
    bad = optimizer.step(Given(gradients), iteration)
    assert callable(bad) == (device != "cpu") and (bad() if callable(bad) else bad) == "quats"
    return left


@pytest.mark.parametrize("device", DEVICES)
def test_it_is_that_of_torch(monkeypatch, device):
    exact = stepped("cpu", torch.float64)
    if device == "cpu":
        monkeypatch.setattr(optimizing, "fuses", lambda values: True)
    for found, again, want in zip(*(stepped(device, torch.float32) for _ in range(2)), exact, strict=True):
        assert torch.equal(found, again) and ((found - want).norm(dim=0) <= 1e-6 * want.norm(dim=0)).all()


@pytest.mark.cuda
def test_torch_steps_on_the_gpu_without_warp(monkeypatch):
    """Learning rates come through pinned memory."""
    monkeypatch.setattr(optimizing, "fuses", lambda values: False)
    for found, want in zip(stepped("cuda", torch.float32), stepped("cpu", torch.float64), strict=True):
        assert ((found - want).norm(dim=0) <= 1e-6 * want.norm(dim=0)).all()

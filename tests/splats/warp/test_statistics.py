"""Density control's statistics by Warp's kernels, against torch in float64: on Warp's CPU device, and on a GPU."""

import dataclasses

import pytest
import torch
from hydra.utils import instantiate

from tdgbench.splats import density as density_control
from tdgbench.splats.backends import warp
from tdgbench.splats.density import DensityControl
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.state import TrainingState
from tests.helpers.configs import config
from tests.splats.backward_passes import cloud

REASON = warp.BACKEND.why_not()
pytestmark = pytest.mark.skipif(REASON is not None, reason=str(REASON))
DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.cuda)]
COUNT = 120


def view(number: int, dense: bool, absolute: bool) -> Gradients:
    """Gradients, float64, of 120 Gaussians, of which about a third are not visible; or rows of 80, in two spans."""
    g = torch.Generator().manual_seed(number)
    grads, absolutes = torch.randn(2, COUNT, 2, generator=g, dtype=torch.float64) * 1e-5
    radii = (torch.randint(-9, 20, (COUNT,), generator=g)).clamp_min(0).int()
    found = Gradients.dense(torch.zeros(COUNT, 16), grads, radii, absolutes.abs() if absolute else None)
    if dense:
        return found
    rows = torch.randperm(COUNT, generator=g)[:80].int()
    spans = [(0, 30), (40, 40)]
    return Gradients(spans, rows, torch.zeros(80, 16), found.image[rows], spans, rows, radii[rows])


def observed(device: str, dtype: torch.dtype, dense: bool, absolute: bool) -> dict:
    """What density control has accumulated over three views."""
    rules = instantiate(config("budget=paper").budget.density)
    if absolute:
        rules = dataclasses.replace(rules, gradient="absolute")
    state = TrainingState(cloud(1, 0, dtype).map(lambda t: t.to(device)))
    control = DensityControl(rules, 1.0, state, 1000)
    for number in range(3):
        given = view(number, dense, absolute)
        for name in ("index", "values", "image", "projected", "radii"):
            tensor = getattr(given, name)
            setattr(given, name, tensor.to(device, dtype if tensor.is_floating_point() else None))
        control.observe_visible(given)
        control.observe_gradients(given, 100, 50)
    return {name: sums for name, sums in control.state_dict().items() if name in control.accumulated}


@pytest.mark.parametrize("absolute", [False, True])
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("device", DEVICES)
def test_they_are_those_of_torch_in_float64(monkeypatch, device, dense, absolute):
    exact = observed("cpu", torch.float64, dense, absolute)
    calls = []
    monkeypatch.setattr(DensityControl, "_is_fast", property(lambda self: False))
    monkeypatch.setattr(density_control, "fuses", lambda tensor: calls.append(tensor) or True)
    first, again = (observed(device, torch.float32, dense, absolute) for _ in range(2))
    assert len(calls) == 12 and set(first) == set(exact) and ("absolute_sum" in first) == absolute
    for name, want in exact.items():
        assert torch.equal(first[name], again[name]), name
        if name in ("view_counts", "max_radii"):
            assert torch.equal(first[name].double(), want) and 0 < (want > 0).sum() < COUNT
        else:
            assert ((first[name] - want).abs() <= 1e-6 * want.max()).all() and want.max() > 0


def test_torch_in_float32_is_that_in_float64(monkeypatch):
    """Where neither Numba's kernels nor Warp's run, as for gsplat without Warp."""
    exact = observed("cpu", torch.float64, True, True)
    monkeypatch.setattr(DensityControl, "_is_fast", property(lambda self: False))
    for name, found in observed("cpu", torch.float32, True, True).items():
        assert ((found - exact[name]).abs() <= 1e-6 * exact[name].max()).all()

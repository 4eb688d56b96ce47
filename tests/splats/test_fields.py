"""Further named fields of Gaussians: in rows, under Adam, density control and in PLY files."""

from dataclasses import replace

import pytest
import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.backends.backend import StateOptions
from tdgbench.splats.backends.cpu import BACKEND
from tdgbench.splats.cpu.adam import FLUSH_EVERY
from tdgbench.splats.gradients import Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tdgbench.splats.view import GaussianTensors, Pinhole
from tests.helpers.deferred import step_gradients
from tests.helpers.gaussians import RATES, model

OWN = {"sh_rgb": "sh", "opacity_rgb": 0.02, "means": 0.0}


def two_colour_sets(count: int = 40) -> Gaussians:
    draw = torch.Generator().manual_seed(5)
    more = {"sh_rgb": torch.randn(count, 4, 3, generator=draw), "opacity_rgb": torch.randn(count, 1, generator=draw)}
    return replace(model(1, 1, count=count), extra_fields=more)


def test_each_field_has_its_rate():
    """A frozen field stays, and a colour set moves like the first one under the same gradients."""
    state = TrainingState(two_colour_sets())
    start = state.split(state.values.clone())
    optimizer = Adam(state, RATES, 2.0, OWN)
    reference = (
        torch.cat([start.sh.repeat(1, 1, 3), start.extra_fields["sh_rgb"]], dim=2).flatten(1).double().requires_grad_()
    )
    dc = [6 * k + c for k in range(4) for c in range(6)]
    rates = torch.tensor([RATES.sh_dc if column < 6 else RATES.sh_rest for column in dc], dtype=torch.float64)
    peer = torch.optim.Adam([reference], lr=1.0, betas=(0.9, 0.999), eps=1e-15)
    for step in range(1, FLUSH_EVERY + 20):
        gradients = step_gradients(state, step, 0.5)
        index, rows, _ = gradients.rows()
        dense = torch.zeros(len(state), state.values.shape[1])
        dense[index] = rows
        parts = state.split(dense)
        before = reference.detach().clone()
        reference.grad = torch.cat([parts.sh.repeat(1, 1, 3), parts.extra_fields["sh_rgb"]], dim=2).flatten(1).double()
        peer.step()
        reference.data = before + rates * (reference.data - before)
        optimizer.step(gradients, step)
    optimizer.flush()
    now = state.split(state.values)
    assert torch.equal(now.means, start.means)
    assert not torch.equal(now.extra_fields["opacity_rgb"], start.extra_fields["opacity_rgb"])
    moved = reference.detach().unflatten(1, (4, 6))
    for ours, theirs in ((now.sh, moved[..., :1]), (now.extra_fields["sh_rgb"], moved[..., 3:])):
        assert (ours.double() - theirs).abs().max() < 1e-4


def test_rates_and_fields_must_fit():
    state = TrainingState(two_colour_sets())
    with pytest.raises(ValueError, match=r"the fields are means, .*sh_rgb, opacity_rgb"):
        Adam(state, RATES, 2.0, {"sh_rgb": "sh"})
    with pytest.raises(ValueError, match="there are rates for"):
        Adam(state, RATES, 2.0, {**OWN, "sh_depth": "sh"})


def test_a_field_that_an_iteration_lacks_keeps_its_momentum():
    """Two colour sets, of which steps have one or the other: as float64 Adam with gradients of 0."""
    sets = two_colour_sets().extra_fields["sh_rgb"]
    state = TrainingState(replace(model(1, 1, count=40), extra_fields={"sh_rgb": sets}))
    start = state.split(state.values.clone())
    optimizer = Adam(state, RATES, 2.0, {"sh_rgb": 0.01})
    peer_value = start.extra_fields["sh_rgb"].flatten(1).double().requires_grad_()
    peer = torch.optim.Adam([peer_value], lr=0.01, betas=(0.9, 0.999), eps=1e-15)
    few = state.columns_of("sh").stop
    for step in range(1, 2 * FLUSH_EVERY):
        index, rows, _ = step_gradients(state, step, 1.0).rows()
        dense = torch.zeros(len(state), state.values.shape[1])
        dense[index] = rows
        if step % 3 == 0:
            dense[:, few:] = 0
        peer_value.grad = state.split(dense).extra_fields["sh_rgb"].flatten(1).double()
        peer.step()
        shown = dense if step % 3 else dense[:, :few].contiguous()
        radii = torch.ones(len(state), dtype=torch.int32)
        optimizer.step(Gradients.dense(shown, torch.zeros(len(state), 2), radii), step)
    optimizer.flush()
    found = state.split(state.values).extra_fields["sh_rgb"].flatten(1)
    assert (found.double() - peer_value.detach()).abs().max() < 1e-4


@pytest.mark.parametrize("width", [40, 64])
def test_a_state_wider_than_a_fused_step_is_stepped_alike(width):
    """One step has gradients of a field of so many numbers, the later ones have not."""
    values = []
    for count in (1, width):
        given = model(3, 3, count=40)
        means = torch.randn(40, 3, generator=torch.Generator().manual_seed(1)) / 2 + torch.tensor([0, 0, 4.0])
        state = TrainingState(replace(given, means=means, extra_fields={"features": torch.ones(40, count)}))
        optimizer, camera = Adam(state, RATES, 2.0, {"features": 0.0}), Pinhole(torch.eye(4), K, 64, 48)
        for step in range(1, 8):
            got = []
            options = StateOptions(3, False, hook=with_features if step == 1 else None)
            render = BACKEND.render_state(state, optimizer.row_steps, camera, options, got.append)
            (render.image - 0.5).square().sum().backward()
            assert optimizer.step(got[0], step) is None
        optimizer.flush()
        values.append(state.values[:, : state.columns_of("features").start])
    assert torch.equal(*values)


K = torch.tensor([[60.0, 0, 32], [0, 60, 24], [0, 0, 1]])


def with_features(gaussians: Gaussians, degree: int) -> GaussianTensors:
    tensors = gaussians.activated(degree)
    return tensors._replace(colors=tensors.colors + 0 * gaussians.extra_fields["features"].sum())

import math

import numpy as np
import pytest
import torch

from tdgbench.splats import Gaussians
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.adam import FLUSH_EVERY, MAX_SPEED, DeferredSteps
from tdgbench.splats.gradients import BETA1, BETA2, EPS, Gradients
from tdgbench.splats.optimizer import Adam
from tdgbench.splats.state import TrainingState
from tests.helpers.deferred import apply_deferred_steps, step_gradients
from tests.helpers.gaussians import RATES, model

EXTENT = 2.0


def torch_groups(state: TrainingState, leaves: Gaussians) -> list[dict]:
    rates = {"means": 0.0, "log_scales": RATES.log_scales, "quats": RATES.quats, "opacity_logits": RATES.opacity_logits}
    return [{"params": [getattr(leaves, name)], "lr": rate} for name, rate in rates.items()]


@pytest.mark.parametrize("share", [1.0, 0.3, 0.02])
@pytest.mark.parametrize("channels", [1, 3])
def test_is_torch_adam(share, channels):
    """Rows without gradient included: torch moves them by their momentum at each step."""
    state = TrainingState(model(channels, 2, count=133))
    start = state.split(state.values.clone())
    optimizer = Adam(state, RATES, EXTENT)
    theirs = start.map(lambda t: t.detach().double().clone().requires_grad_())
    dc, rest = (t.detach().clone().requires_grad_() for t in (theirs.sh[:, :1], theirs.sh[:, 1:]))
    groups = torch_groups(state, theirs)
    groups += [{"params": [dc], "lr": RATES.sh_dc}, {"params": [rest], "lr": RATES.sh_rest}]
    peer = torch.optim.Adam(groups, betas=(BETA1, BETA2), eps=EPS)
    for step in range(1, 2 * FLUSH_EVERY + 40):
        gradients = step_gradients(state, step, share)
        index, rows, _ = gradients.rows()
        dense = torch.zeros(len(state), state.values.shape[1], dtype=torch.float64)
        dense[index] = rows.double()
        parts = state.split(dense)
        for name, tensor in theirs.items():
            if name != "sh":
                tensor.grad = getattr(parts, name).clone()
        dc.grad, rest.grad = parts.sh[:, :1].clone(), parts.sh[:, 1:].clone()
        peer.param_groups[0]["lr"] = RATES.means(step) * EXTENT
        optimizer.step(gradients, step)
        peer.step()
    optimizer.flush()
    ours = state.split(state.values)
    moved = {"sh": torch.cat([dc, rest], dim=1)}
    for name, tensor in ours.items():
        want = moved.get(name, getattr(theirs, name)).detach()
        travelled = (want - getattr(start, name).double()).abs().max()
        assert (tensor.double() - want).abs().max() < 1e-5 * max(travelled.item(), 1.0), name
    moments = optimizer.state.split(state.second).means.double()
    assert torch.allclose(moments, peer.state[theirs.means]["exp_avg_sq"], rtol=1e-4, atol=1e-12)


def test_gradients_too_small_to_be_squared_move_nothing_far():
    """Their second moment is 0 in float32, their first one is not."""
    state = TrainingState(model(1, 0, count=60))
    start, optimizer = state.values.clone(), Adam(state, RATES, EXTENT)
    theirs = start.double().requires_grad_()
    peer = torch.optim.Adam([theirs], lr=RATES.opacity_logits, betas=(BETA1, BETA2), eps=EPS)
    column, sizes = state.columns_of("opacity_logits"), torch.logspace(-30, -2, 60)
    for step in range(1, 40):
        dense = torch.zeros(60, state.values.shape[1])
        index = torch.arange(60, dtype=torch.int32)
        if step == 1:
            dense[:, column] = sizes[:, None]
        else:
            index, dense = index[:0], dense[:0]
        spans = [(0, len(index))]
        optimizer.step(Gradients(spans, index, dense.clone(), torch.zeros(60, 3), [], index, index), step)
        theirs.grad = torch.zeros_like(theirs)
        theirs.grad[: len(dense)] = dense.double()
        peer.step()
    optimizer.flush()
    moved, wanted = ((p[:, column] - start[:, column]).double().squeeze(1) for p in (state.values, theirs.detach()))
    assert torch.allclose(moved[sizes > 1e-11], wanted[sizes > 1e-11], rtol=1e-3)
    assert moved[sizes < 1e-18].abs().max() < 0.05 * RATES.opacity_logits
    assert (moved - wanted).abs().max() < 0.2 * wanted.abs().max()  # where eps weighs as much as √v


def test_deferred_steps_stay_within_the_tolerance():
    state = TrainingState(model(1, 0, count=60))
    optimizer = Adam(state, RATES, EXTENT)
    for step in range(1, 20):
        gradients = step_gradients(state, step, 1.0)
        gradients.values.abs_()  # all in one direction: as fast as it gets
        optimizer.step(gradients, step)
    tolerance = optimizer.tolerance(20)
    before, bounds = state.values.clone(), state.bounds.clone()
    for step in range(20, 20 + FLUSH_EVERY // 2):
        optimizer.step(step_gradients(state, step, 0.0), step)
    apply_deferred_steps(optimizer, np.arange(60, dtype=np.int32))
    moved = (state.values - before).abs()
    assert 0 < moved[:, state.columns_of("means")].max() < tolerance.mean
    assert 0 < moved[:, state.columns_of("log_scales")].max() < tolerance.log_scale
    assert torch.equal(state.bounds, bounds)


def test_no_step_is_longer_than_the_bound():
    """|m| / √v after any gradients: the worst are those that grow by β2 / β1 from step to step."""
    m = v = 0.0
    for step in range(200):
        g = (BETA2 / BETA1) ** step * 1e-9
        m, v = BETA1 * m + (1 - BETA1) * g, BETA2 * v + (1 - BETA2) * g * g
    assert 0.99 * MAX_SPEED < abs(m) / math.sqrt(v) <= MAX_SPEED * (1 + 1e-9)
    decay = sum((BETA1 / math.sqrt(BETA2)) ** j for j in range(1, 2000))
    assert pytest.approx(MAX_SPEED * decay) == DeferredSteps.most_deferred


def test_same_bytes_on_any_number_of_threads():
    results = []
    for threads in (1, 2, 5):
        pool.set_threads(threads)
        state = TrainingState(model(3, 1, count=101))
        optimizer = Adam(state, RATES, EXTENT)
        for step in range(1, 30):
            optimizer.step(step_gradients(state, step, 0.4), step)
        optimizer.flush()
        results.append(state.values.numpy().tobytes())
    assert len(set(results)) == 1


def test_a_step_without_one_parameter():
    state = TrainingState(model(1, 0, count=9))
    optimizer = Adam(state, RATES, EXTENT)
    optimizer.step(step_gradients(state, 1, 1.0), 1)
    optimizer.reset_moments("opacity_logits")
    column = state.columns_of("opacity_logits")
    before, others = state.values[:, column].clone(), state.values[:, :3].clone()
    optimizer.step(step_gradients(state, 2, 1.0), 2, without=("opacity_logits",))
    assert torch.equal(state.values[:, column], before) and not torch.equal(state.values[:, :3], others)
    assert (optimizer.steps["opacity_logits"], optimizer.steps["means"]) == (1, 2)
    assert not state.second[:, column].any() and state.second[:, :3].any()

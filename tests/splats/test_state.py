import numpy as np
import pytest
import torch

from tdgbench.splats.cpu.scratch import empty_rows
from tdgbench.splats.state import REORDER_AT, TrainingState
from tests.helpers.gaussians import model


def state_of(count: int, channels: int = 1, degree: int = 1) -> TrainingState:
    state = TrainingState(model(channels, degree, count=count))
    state.first[:] = torch.arange(count)[:, None].float()
    state.second[:] = 2 * state.first
    return state


@pytest.mark.parametrize(("channels", "degree"), [(1, 0), (3, 3)])
def test_holds_the_gaussians_it_was_given(channels, degree):
    given = model(channels, degree, count=20)
    state = TrainingState(given)
    held = state.split(state.values)
    order = [int((given.means == mean).all(dim=1).nonzero()) for mean in held.means]
    assert sorted(order) == list(range(20))
    for (_, a), (_, b) in zip(held.items(), given.items(), strict=True):
        assert torch.equal(a, b[order])
    assert state.values.data_ptr() % 64 == 0 and state.values.shape[1] == max(state.columns, 16)
    assert torch.equal(state.bounds[:, 3], held.log_scales.amax(dim=1))


@pytest.mark.parametrize("zeros", [False, True])
def test_rows_may_be_read_a_line_beyond_their_end(zeros):
    """Registers of the last row are loaded whole."""
    rows = whole = empty_rows(7, 27, zeros)
    while whole.base is not None:
        whole = whole.base
    assert rows.ctypes.data % 64 == 0 and rows.ctypes.data + rows.nbytes + 64 <= whole.ctypes.data + whole.nbytes
    assert not zeros or not rows.any()


@pytest.mark.parametrize(("removed", "added"), [(0, 3), (2, 2), (2, 5), (4, 1), (6, 0), (0, 0), (3, 40)])
def test_exchange(removed, added):
    state = state_of(6)
    before, gone = state.values.clone(), torch.randperm(6, generator=torch.Generator().manual_seed(0))[:removed]
    gone = gone.sort().values
    new = state.rows_of(model(1, 1, count=added)) + 100
    state.replace_rows(gone, new)
    kept = [i for i in range(6) if i not in gone.tolist()]
    want = torch.cat([before[kept], new])
    assert len(state) == len(want)
    ours, theirs = (sorted(map(tuple, rows.tolist())) for rows in (state.values, want))
    assert ours == theirs
    for row, first, second, bounds in zip(state.values, state.first, state.second, state.bounds, strict=True):
        old = (before == row).all(dim=1).nonzero().flatten().tolist()
        assert first[0] == (old[0] if old else 0) and second[0] == 2 * first[0]
        assert torch.equal(bounds[:3], row[:3]) and bounds[3] == row[state.columns_of("log_scales")].max()


def test_clocks_start_where_the_optimiser_is():
    state = state_of(4)
    state.now = 17
    state.replace_rows(torch.tensor([1]), state.rows_of(model(1, 1, count=3)))
    assert (state.clocks == 17).all() and len(state.clocks) == 6


def test_neighbours_stand_beside_each_other():
    points = torch.rand(4096, 3, generator=torch.Generator().manual_seed(0))
    given = model(1, 0, count=4096)
    given.means[:] = points
    state = TrainingState(given)
    held = state.split(state.values).means
    steps, random_steps = ((p[1:] - p[:-1]).norm(dim=1).mean() for p in (held, points))
    assert steps < 0.15 * random_steps
    state.first[:, 0] = held[:, 0]
    state.replace_rows(
        torch.tensor([], dtype=torch.int64), state.rows_of(model(1, 0, count=int(4096 * REORDER_AT))) + 0.5
    )
    assert torch.equal(state.first[state.first[:, 0] != 0][:, 0], state.values[state.first[:, 0] != 0][:, 0])


def test_positions_that_are_not_finite_do_not_stop_it():
    given = model(1, 0, count=4)
    given.means[1, 0] = torch.nan
    state = TrainingState(given)
    assert np.isnan(state.values[:, 0].numpy()).sum() == 1

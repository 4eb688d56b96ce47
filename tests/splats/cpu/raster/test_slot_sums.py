import numpy as np
import pytest

from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.raster.blend_backward import slot_size
from tdgbench.splats.cpu.raster.projection_backward import NO_FUSED_STEP
from tdgbench.splats.cpu.raster.slot_sums import BATCH, SLOT, Batch, fill_batch, turn_sums
from tdgbench.splats.cpu.raster.types import Channels, Slots, Splats
from tdgbench.splats.cpu.scratch import empty_aligned
from tdgbench.splats.cpu.simd.registers import LANES
from tests.helpers.gaussians import random_gaussians
from tests.splats.cpu.raster.forward_passes import source_of

F, WHOLE = np.float32, np.int32


@kernel()
def fill(batch, r, end, splats, slots, parameters, channels, step):
    return fill_batch(batch, r, end, splats, slots, parameters, channels, step)


@kernel()
def turn(batch, first, totals):
    turn_sums(batch, first, totals)


def new_batch() -> Batch:
    sums = empty_aligned((BATCH * SLOT,), F)
    sums[:] = np.nan
    return Batch(sums, np.full(BATCH, -1, WHOLE), np.full(BATCH, -1, WHOLE))


def splats_and_slots(count: int, channels: int) -> tuple[Splats, Slots, np.ndarray]:
    """Splats with 0 to 4 slots each, of which some were not written; and the sums (count, floats) of those that were.

    A third of the splats has nothing but zeros in them.
    """
    rng, floats = np.random.default_rng(0), slot_size(channels)
    ends = np.cumsum(rng.integers(0, 5, count))
    pairs = np.column_stack([np.append(0, ends[:-1]), ends]).astype(WHOLE)
    values = rng.normal(size=(ends[-1], floats)).astype(F)
    written = rng.random(ends[-1]) > 0.3
    sums = np.zeros((count, floats), F)
    for r, (first, last) in enumerate(pairs):
        if r % 3 == 0:
            values[first:last] = 0
        for slot in range(first, last):
            if written[slot]:
                sums[r] += values[slot]
    values[~written] = np.nan  # memory that nobody wrote
    flat = np.append(values.reshape(-1), np.full(SLOT, np.nan, F))
    ids = rng.permutation(count).astype(WHOLE)
    return Splats(np.zeros((count, 16), F), ids, pairs, np.zeros(count, np.uint32)), Slots(flat, written), sums


@pytest.mark.parametrize(("colors", "depth"), [(1, False), (3, True)])
def test_sums_over_the_written_slots(colors, depth):
    """In batches; every splat whose sum is not zero is in one, in the order of the splats."""
    count = 3 * BATCH
    splats, slots, sums = splats_and_slots(count, colors + depth)
    parameters = source_of(random_gaussians(count, 1, None, colors)).parameters
    batch, r, order, found = new_batch(), 0, [], []
    while r < count:
        filled, r = fill(batch, r, count, splats, slots, parameters, Channels(colors, -1, depth), NO_FUSED_STEP)
        assert filled == BATCH or r == count
        order.append(batch.splat_ids[:filled].copy())
        found.append(batch.sums.reshape(BATCH, SLOT)[:filled, : sums.shape[1]].copy())
        assert np.array_equal(batch.gaussian_ids[:filled], splats.gaussian_ids[batch.splat_ids[:filled]])
    order, wanted = np.concatenate(order), np.flatnonzero(sums.any(axis=1))
    assert BATCH < len(wanted) < count and np.array_equal(order, wanted)
    assert np.array_equal(np.concatenate(found), sums[wanted])


def test_the_last_register_is_filled_up():
    splats, slots, sums = splats_and_slots(9, 1)
    wanted = np.flatnonzero(sums.any(axis=1))
    parameters, batch = source_of(random_gaussians(9, 1, None, 1)).parameters, new_batch()
    filled, r = fill(batch, 0, 9, splats, slots, parameters, Channels(1, -1, False), NO_FUSED_STEP)
    assert (filled, r) == (len(wanted), 9) and 0 < filled < LANES
    assert (batch.splat_ids[filled:LANES] == wanted[-1]).all() and (batch.splat_ids[LANES:] == -1).all()
    assert (batch.gaussian_ids[filled:LANES] == splats.gaussian_ids[wanted[-1]]).all()


def test_nan_is_a_gradient():
    splats, slots, _ = splats_and_slots(9, 1)
    slots.values[:] = np.nan
    slots.written[:] = True
    parameters, batch = source_of(random_gaussians(9, 1, None, 1)).parameters, new_batch()
    filled, _ = fill(batch, 0, 9, splats, slots, parameters, Channels(1, -1, False), NO_FUSED_STEP)
    assert filled == (splats.pairs[:, 1] > splats.pairs[:, 0]).sum()


def test_sums_become_registers():
    batch, totals = new_batch(), empty_aligned((SLOT * LANES,), F)
    batch.sums[:] = np.arange(BATCH * SLOT)
    turn(batch, LANES, totals)
    assert np.array_equal(totals.reshape(SLOT, LANES), batch.sums.reshape(BATCH, SLOT)[LANES : 2 * LANES].T)

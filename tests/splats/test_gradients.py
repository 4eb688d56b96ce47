"""Gradients that go straight into a step, and those that are read before it; test_render.py knows the right ones."""

import numpy as np
import pytest
import torch

from tdgbench.splats.cpu import pool
from tdgbench.splats.gaussians import RenderedFields
from tdgbench.splats.gradients import Gradients, GradientStatistics
from tests.splats.backward_passes import HEIGHT, WIDTH, backward_pass, cloud, with_rgb

BOTH = RenderedFields(("sh", "sh_rgb"))


def test_dense_gradients_have_every_gaussian():
    values, image = torch.rand(3, 16), torch.rand(3, 2)
    dense = Gradients.dense(values, image, torch.tensor([4, 0, 2], dtype=torch.int32))
    index, rows, on_image = dense.rows()
    assert index.tolist() == [0, 1, 2] and torch.equal(rows, values) and torch.equal(on_image[:, :2], image)
    assert dense.all_radii(3).tolist() == [4, 0, 2]


def sparse(index, visible, radii, columns: int, factor: float) -> Gradients:
    """Rows with an unused one before the span."""
    padded = torch.tensor([99, *index], dtype=torch.int32)
    values = factor * torch.ones(len(padded), columns)
    return Gradients(
        [(1, len(index))], padded, values, factor * torch.ones(len(padded), 3), [(0, len(visible))],
        torch.tensor(visible, dtype=torch.int32), torch.tensor(radii, dtype=torch.int32),
    )  # fmt: skip


def test_the_sum_of_two_views():
    one, two = sparse([2, 0], [0, 2], [3, 4], 16, 1.0), sparse([2], [1, 2], [0, 9], 32, 10.0)
    assert Gradients.total([one], 4) is one
    total = Gradients.total([one, two], 4)
    assert total.values[:, 0].tolist() == [1, 0, 11, 0] and total.values[:, 20].tolist() == [0, 0, 10, 0]
    assert total.image[:, 1].tolist() == [1, 0, 11, 0] and total.radii.tolist() == [3, 0, 9, 0]


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(("channels", "used", "hook"), [(1, 3, None), (3, 0, None), (3, 2, None), (3, 2, BOTH)])
def test_one_pass_leaves_the_bytes_of_two(threads, channels, used, hook):
    """Over several batches of Gaussians and a register that is not full; absolute gradients change no other result."""
    count, left = 700, []
    pool.set_threads(threads)
    for absgrad, read_first in ((True, False), (True, True), (False, False), (False, True)):
        of_view, sums = {"absgrad": absgrad, "hook": hook, "depth": hook is None}, torch.zeros(2, count)
        done = backward_pass(with_rgb(cloud(channels, 3, count=count)), "cpu", used, **of_view)
        statistics = GradientStatistics(sums[0], sums[1] if absgrad else sums[1, :0], 0.5 * WIDTH, 0.5 * HEIGHT)
        gradients = done.gradients.compute() if read_first else done.gradients
        done.optimizer.step(gradients, 1, statistics=statistics)
        state = done.state
        arrays = (state.values, state.first, state.second, state.bounds, state.clocks, *sums)
        left.append(([array.numpy().tobytes() for array in arrays], gradients.touched))
    assert left[0] == left[1] and left[2] == left[3] and left[0][0][:-1] == left[2][0][:-1] and left[0][1] > 300
    signed, absolute = (np.frombuffer(total, np.float32) for total in left[0][0][-2:])
    assert (absolute >= 0.999 * signed).all() and absolute.sum() > 1.5 * signed.sum()


def test_what_is_known_before_the_gradients():
    pending = backward_pass(cloud(1, 1), "cpu", 1).gradients
    assert pending.touched == 0 and pending.pairs >= pending.blended > 0
    rows = pending.compute()
    assert (rows.pairs, rows.blended, rows.columns) == (pending.pairs, pending.blended, pending.columns)
    assert rows.projected is pending.projected and rows.radii is pending.radii and rows.touched > 0


@pytest.mark.parametrize("name", ["opacity_logits", "sh"])
def test_a_gradient_that_is_not_finite_is_named(name):
    """The sum of opacity's moments, or of a channel's, is infinite."""
    done = backward_pass(cloud(1, 0), "cpu", 0)
    slots = done.gradients.slots
    slots = slots.values[: len(slots.written) * 8].reshape(-1, 8)  # six moments, colour, depth
    slots[:, {"opacity_logits": 0, "sh": 6}[name]] = np.inf
    assert done.optimizer.step(done.gradients, 1) == name

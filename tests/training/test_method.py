import numpy as np
import torch

from tdgbench.training.method import Context, ViewOrder


def test_views_come_once_per_round():
    order = ViewOrder(list(range(7)), torch.Generator().manual_seed(0))  # type: ignore[arg-type]
    rounds = [[order.next() for _ in range(7)] for _ in range(3)]
    assert all(sorted(r) == list(range(7)) for r in rounds)
    assert rounds[0] != rounds[1]


def test_streams_are_independent_and_repeatable(small_scene):
    def draws(seed):
        context = Context(small_scene, small_scene.points, {}, None, "auto", seed)
        return [torch.rand(4, generator=context.generator()).numpy() for _ in range(3)]

    first, again, other = draws(0), draws(0), draws(1)
    assert np.array_equal(first, again)
    assert len({a.tobytes() for a in (*first, *other)}) == 6

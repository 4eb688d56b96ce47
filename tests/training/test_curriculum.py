from dataclasses import replace

import numpy as np
import pytest

from tdgbench.training.context import ViewOrder
from tdgbench.training.curriculum import Curriculum, Resolution, shrunk
from tests.helpers.waves import view, wave

STEPS = [Resolution(10, 4), Resolution(20, 2)]


def test_views_have_the_resolution_of_the_iteration(small_scene):
    view = small_scene.train[0]
    curriculum = Curriculum(STEPS)
    widths = []
    for iteration in (1, 10, 11, 20, 21):
        curriculum.begin(iteration)
        widths.append(curriculum.at_resolution(view).thermal.shape[1])
    assert widths == [12, 12, 24, 24, 48] and curriculum.at_resolution(view) is view


def test_held_out_views_are_not_trained_on_until_they_are_folded_back(small_scene):
    views = small_scene.train
    curriculum = Curriculum(held_out=views[1:3])
    order = ViewOrder(views, 0, curriculum)
    shown = sorted(order.next().name for _ in range(len(views) - 2))
    assert shown == sorted(view.name for view in views if view not in views[1:3])
    curriculum.settle(1, 0.1)
    assert sorted(order.next().name for _ in views) == sorted(view.name for view in views)


@pytest.mark.parametrize("count", [12, 200])
def test_held_out_views_come_within_the_tail_of_a_round_that_has_begun(small_scene, count):
    views = [replace(small_scene.train[0], name=str(i)) for i in range(count)]
    curriculum = Curriculum(held_out=views[::25])
    order = ViewOrder(views, 0, curriculum)
    for _ in range(5):
        order.next()
    curriculum.begin(300)
    curriculum.settle(1, 0.1)
    shown = [order.next().name for _ in range(curriculum.tail)]
    assert curriculum.tail == 30 and {view.name for view in curriculum.held_out} <= set(shown)
    assert len(set(shown)) == min(count, curriculum.tail)  # no view comes twice in a round


def test_it_goes_on_before_the_schedule_and_may_go_back_for_good():
    curriculum = Curriculum(STEPS)
    curriculum.begin(1)
    curriculum.advance()
    assert curriculum.scale == 2
    curriculum.begin(2)
    curriculum.begin(21)
    assert curriculum.is_at_full_resolution
    curriculum.settle(2, 0.1)
    curriculum.begin(22)
    assert curriculum.scale == 2 and curriculum.iterations == {4: 1, 2: 2, 1: 1}
    curriculum.held_out = [None]  # type: ignore[list-item]
    by_scale = {"1/4": 1, "1/2": 2, "1/1": 1}
    assert curriculum.report() == {"iterations": by_scale, "held_out": 1, "settled_at": 21}


def test_a_smaller_view_has_means_and_the_camera_of_them():
    image, rgb = wave(40), np.repeat(wave(30), 3, axis=2)
    small = shrunk(view(image, rgb=rgb), 4)
    assert small.thermal.shape == (24, 32, 1) and small.rgb.shape == (24, 32, 3) and small.valid is None
    assert np.allclose(small.thermal, image.reshape(24, 4, 32, 4, 1).mean(axis=(1, 3)), atol=1e-6)
    assert (small.camera.width, small.camera.height) == (32, 24)
    assert np.allclose(small.camera.K[:2], view(image).camera.K[:2] / 4)


def test_masked_pixels_have_no_part_in_means():
    image, valid = np.full((8, 8, 1), 0.5, np.float32), np.ones((8, 8), bool)
    image[:, :3], valid[:, :3] = 9.0, False
    small = shrunk(view(image, valid), 2)
    assert small.valid.tolist() == [[False, True, True, True]] * 4  # half of the second column's area is valid
    assert np.allclose(small.thermal[..., 0], [[0, 0.5, 0.5, 0.5]] * 4)


def test_a_view_with_few_valid_pixels_keeps_some():
    valid = np.zeros((8, 8), bool)
    valid[2, 5] = True
    small = shrunk(view(np.full((8, 8, 1), 0.25, np.float32), valid), 4)
    assert np.argwhere(small.valid).tolist() == [[0, 1]] and small.thermal[0, 1, 0] == pytest.approx(0.25)

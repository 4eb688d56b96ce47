import dataclasses

import numpy as np
import pytest

from tdgbench.scenes import Camera, View
from tdgbench.training.budget import PixelRule
from tdgbench.training.context import ViewOrder
from tdgbench.training.curriculum import Curriculum, schedule, shrunk
from tdgbench.training.images import RGB, THERMAL


def test_views_have_the_resolution_of_the_iteration(small_scene):
    view = small_scene.train[0]
    curriculum = Curriculum(steps=[(10, 4), (20, 2)])
    widths = []
    for iteration in (1, 10, 11, 20, 21):
        curriculum.begin(iteration)
        widths.append(curriculum.at_resolution(view).thermal.shape[1])
    assert widths == [12, 12, 24, 24, 48] and curriculum.at_resolution(view) is view


def test_a_shrunk_view_is_made_once(small_scene):
    curriculum = Curriculum(steps=[(10, 2)])
    curriculum.begin(1)
    first = curriculum.at_resolution(small_scene.train[0])
    curriculum.begin(2)
    assert curriculum.at_resolution(small_scene.train[0]) is first


def test_held_out_views_are_not_trained_on_until_they_are_folded_back(small_scene):
    views = small_scene.train
    curriculum = Curriculum(held_out=views[1:3])
    order = ViewOrder(views, 0, curriculum)
    shown = sorted(order.next().name for _ in range(len(views) - 2))
    assert shown == sorted(view.name for view in views if view not in views[1:3])
    curriculum.settle(1)
    assert sorted(order.next().name for _ in views) == sorted(view.name for view in views)


def test_it_goes_on_before_the_schedule_and_may_go_back_for_good():
    curriculum = Curriculum(steps=[(10, 4), (20, 2)])
    curriculum.begin(1)
    curriculum.advance()
    assert curriculum.scale == 2
    curriculum.begin(2)
    curriculum.begin(21)
    assert curriculum.is_at_full_resolution
    curriculum.settle(2)
    curriculum.begin(22)
    assert curriculum.scale == 2 and curriculum.iterations == {4: 1, 2: 2, 1: 1}
    curriculum.held_out = [None]  # type: ignore[list-item]
    by_scale = {"1/4": 1, "1/2": 2, "1/1": 1}
    assert curriculum.report() == {"iterations": by_scale, "held_out": 1, "settled_at": 21}


RULE = PixelRule(largest_scale=8, until=0.5, smallest_side=10)


def view(image: np.ndarray, valid: np.ndarray | None = None, rgb: np.ndarray | None = None) -> View:
    height, width = image.shape[:2]
    camera = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), width, height)
    load_valid, load_rgb = (None if a is None else (lambda a=a: a) for a in (valid, rgb))
    return View("v", camera, lambda: image, load_rgb, load_valid=load_valid)


def wave(period: float) -> np.ndarray:
    y, x = np.mgrid[:96, :128]
    return (0.5 + 0.4 * np.sin(2 * np.pi * (x + 0.7 * y) / period))[..., None].astype(np.float32)


def test_fine_images_get_their_pixels_early_and_coarse_ones_late():
    coarse, fine = (schedule(RULE, [view(wave(period))], THERMAL, 100, 1000) for period in (40, 3))
    assert [scale for _, scale in coarse] == [8, 6, 4, 3, 2] and coarse[0][0] > 300
    assert [last for last, _ in coarse] == sorted(last for last, _ in coarse) and coarse[-1][0] <= 500
    assert all(last < 60 for last, _ in fine)


def test_images_do_not_get_smaller_than_the_rule_says():
    rule = dataclasses.replace(RULE, smallest_side=40)
    assert [scale for _, scale in schedule(rule, [view(wave(40))], THERMAL, 100, 1000)] == [2]
    assert schedule(dataclasses.replace(RULE, largest_scale=1), [view(wave(40))], THERMAL, 100, 1000) == []


def test_images_have_no_fewer_pixels_than_there_are_gaussians():
    pixels = 128 * 96
    assert [scale for _, scale in schedule(RULE, [view(wave(40))], THERMAL, pixels // 9, 1000)] == [3, 2]
    assert schedule(RULE, [view(wave(40))], THERMAL, pixels, 1000) == []


def test_each_modality_has_a_schedule_of_its_own():
    both = [view(wave(40), rgb=np.repeat(wave(3), 3, axis=2))]
    thermal, rgb = (schedule(RULE, both, modality, 100, 1000) for modality in (THERMAL, RGB))
    assert thermal[-1][0] > 300 and all(last < 60 for last, _ in rgb)


def test_the_border_of_a_mask_is_no_detail():
    ramp = np.tile(np.linspace(0.2, 0.8, 128, dtype=np.float32)[None, :, None], (96, 1, 1))
    valid = np.ones((96, 128), bool)
    valid[:, 100:] = False
    given = view(ramp), view(ramp * valid[..., None], valid)
    whole, masked = (schedule(RULE, [one], THERMAL, 100, 1000) for one in given)
    assert [scale for _, scale in masked] == [scale for _, scale in whole]
    assert [last for last, _ in masked] == pytest.approx([last for last, _ in whole], abs=10)


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

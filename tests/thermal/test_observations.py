from dataclasses import replace

import numpy as np

from tdgbench.thermal.observations import FEWEST_VIEWS, find_observations


def test_values_are_those_of_the_points(clean_scene):
    seen = find_observations(clean_scene.train, clean_scene.points.points)
    counts = np.bincount(seen.point)
    assert seen.points == len(counts) and counts.min() >= FEWEST_VIEWS
    spread = [np.ptp(seen.value[seen.point == one]) for one in range(0, seen.points, 10)]
    assert np.median(spread) < 0.02 < 0.2 < np.ptp(seen.value)
    first = seen.view == 0
    pixel = seen.y[first].astype(int), seen.x[first].astype(int)
    exact = clean_scene.train[0].thermal[..., 0][pixel]
    assert np.median(np.abs(seen.value[first] - exact)) < 0.01


def test_clipped_and_masked_pixels_are_left_out(clean_scene):
    image, valid = clean_scene.train[0].thermal.copy(), np.ones((72, 96), bool)
    image[:, :15], valid[:, 75:] = 1.0, False
    view = replace(clean_scene.train[0], load_thermal=lambda: image, load_valid=lambda: valid)
    seen = find_observations([view, *clean_scene.train[1:]], clean_scene.points.points)
    x = seen.x[seen.view == 0]
    assert len(x) and x.min() > 17 and x.max() < 73 and seen.x[seen.view == 1].min() < 15


def test_a_mask_beside_a_point_moves_no_value(clean_scene):
    """The values blur over more pixels than must be valid."""
    valid = np.ones((72, 96), bool)
    valid[:, 45:] = False
    image = np.full((72, 96, 1), 0.6, np.float32)
    views = [replace(view, load_thermal=lambda: image, load_valid=lambda: valid) for view in clean_scene.train]
    seen = find_observations(views, clean_scene.points.points)
    assert seen.x.max() > 42 and np.abs(seen.value - 0.6).max() < 1e-6 and seen.slope.max() < 1e-6

"""The rule for points: one measured point in each part of a training image without detail."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tdgbench.scenes import Camera
from tdgbench.training.images import RGB, THERMAL
from tdgbench.training.points import PointRule, squares_without_detail
from tests.helpers.waves import view, wave

RULE = PointRule(z=8, largest=32, most=1.0)


def wall(width=128, height=96, step=2):
    """Points on the plane z = 100, of which one lies at each `step`-th pixel of the camera of `view`."""
    y, x = np.mgrid[step / 2 : height : step, step / 2 : width : step]
    return np.stack([x, y, np.full_like(x, 100.0)], axis=-1).reshape(-1, 3)


def divided(image, least, x, y, side):
    """Return the squares (x, y, side) of a square of an image, by recursion, and whether it has detail."""
    square, half = image[y : y + side, x : x + side], side // 2
    if side == 1:
        return [(x, y, 1)], False
    parts = [divided(image, least, x + u, y + v, half) for v in (0, half) for u in (0, half)]
    a, b, c, d = (square[v : v + half, u : u + half].sum(axis=(0, 1)) for v in (0, half) for u in (0, half))
    coefficients = np.array([a - b + c - d, a + b - c - d, a - b - c + d]) / side
    has_detail = np.sqrt((coefficients**2).mean(axis=1)).max() > least or any(found for _, found in parts)
    return ([one for squares, _ in parts for one in squares] if has_detail else [(x, y, side)]), has_detail


@settings(max_examples=30)
@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 3), st.floats(0, 3), st.integers(0, 99))
def test_squares_are_those_of_a_recursion(width, height, channels, least, seed):
    rng = np.random.default_rng(seed)
    image = rng.normal(size=(height, width, channels)) * rng.integers(0, 2, (height, width, 1))
    found = squares_without_detail(image, least, 8)
    padded = np.pad(image, ((0, -height % 8), (0, -width % 8), (0, 0)), mode="edge")
    corners = [(x, y) for y in range(0, len(padded), 8) for x in range(0, padded.shape[1], 8)]
    expected = [square for x, y in corners for square in divided(padded, least, x, y, 8)[0]]
    assert sorted(map(tuple, found.middle)) == sorted((x + side / 2, y + side / 2) for x, y, side in expected)
    for x, y, side in expected:
        inside = found.number[y : y + side, x : x + side]
        assert (inside == inside.flat[0]).all() if inside.size else True
        assert not inside.size or tuple(found.middle[inside.flat[0]]) == (x + side / 2, y + side / 2)


def noisy(image, sigma=0.02):
    return np.random.default_rng(0).normal(image, sigma).astype(np.float32)


def with_checks(image):
    """Return an image whose right quarter has checks of 4 px."""
    image = image.copy()
    image[:, 96:] += 0.5 * (np.indices((96, 32)).sum(axis=0) // 4 % 2)[..., None]
    return image


PLAIN = np.full((96, 128, 1), 0.3)


def test_noise_is_no_detail_and_edges_are():
    assert RULE.kept_points(wall(), [view(noisy(PLAIN))], THERMAL).sum() == 12  # squares of 32 px
    kept = wall()[RULE.kept_points(wall(), [view(noisy(with_checks(PLAIN)))], THERMAL)]
    assert (kept[:, 0] < 96).sum() == 9 and (kept[:, 0] >= 96).sum() > 300


def test_every_square_that_shows_a_point_keeps_one():
    views = [view(noisy(image)) for image in (with_checks(PLAIN), wave(200), PLAIN)]
    for number, one in enumerate(views):  # moved along the wall
        one.camera = Camera(one.camera.K, _moved(20.0 * number), one.camera.width, one.camera.height)
    points = wall(width=200, step=3)
    kept = RULE.kept_points(points, views, THERMAL)
    assert 10 < kept.sum() < len(points) / 2
    least = RULE.z * THERMAL.typical_noise(views)
    for one in views:
        squares = squares_without_detail(one.thermal, least, RULE.largest)
        pixels, z = one.camera.project(points)
        shown = one.camera.holds(pixels, z)
        of_points = np.full(len(points), -1)
        of_points[shown] = squares.number[pixels[shown, 1].astype(int), pixels[shown, 0].astype(int)]
        assert set(of_points[shown]) == set(of_points[shown & kept])


def _moved(x):
    pose = np.eye(4)
    pose[0, 3] = -x
    return pose


def test_only_thermal_pixels_that_count_decide():
    both = view(noisy(PLAIN), rgb=noisy(PLAIN.repeat(3, axis=2)))
    assert RULE.kept_points(wall(), [both], THERMAL).sum() == 12 and RULE.kept_points(wall(), [both], RGB) is None
    valid = np.ones((96, 128), bool)
    valid[:, 64:] = False
    half = np.where(valid[..., None], noisy(wave(90)), np.random.default_rng(0).random((96, 128, 1))).astype(np.float32)
    kept = wall()[RULE.kept_points(wall(), [view(half, valid)], THERMAL)]
    assert kept[:, 0].max() < 64  # what is behind the mask is not trained


def test_points_that_no_view_shows_do_not_leave_a_model_empty():
    behind = wall() * [1, 1, -1]
    assert RULE.kept_points(behind, [view(noisy(PLAIN))], THERMAL) is None
    assert RULE.kept_points(behind[:0], [view(noisy(PLAIN))], THERMAL) is None


def test_where_most_points_have_detail_all_are_kept():
    views = [view(noisy(with_checks(PLAIN)))]
    share = RULE.kept_points(wall(), views, THERMAL).mean()
    assert 0.05 < share < 0.5
    assert replace(RULE, most=share - 0.01).kept_points(wall(), views, THERMAL) is None
    assert replace(RULE, most=share + 0.01).kept_points(wall(), views, THERMAL).mean() == share

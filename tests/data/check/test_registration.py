import numpy as np
import pytest
from scipy import ndimage

from tdgbench.data.check.registration import Offset, ViewPair, edge_offset

FINE = 4  # samples per pixel and side, so that shifts by parts of a pixel are exact


def made_pairs(shift: tuple[float, float], views: int = 5, noise: float = 0.02, seed: int = 0) -> list[ViewPair]:
    """Views of random rectangles whose RGB and thermal values have nothing in common but their edges.

    shift: (x, y) in px, multiples of 1 / FINE, of the thermal images.
    """
    rng = np.random.default_rng(seed)
    pairs = []
    for _ in range(views):
        rgb, thermal = np.full((96 * FINE, 128 * FINE, 3), 0.5), np.full((96 * FINE, 128 * FINE), 0.5)
        for _ in range(25):
            top, left = rng.integers(0, 80 * FINE), rng.integers(0, 110 * FINE)
            bottom, right = top + rng.integers(8 * FINE, 40 * FINE), left + rng.integers(8 * FINE, 40 * FINE)
            rgb[top:bottom, left:right], thermal[top:bottom, left:right] = rng.random(3), rng.random()
        thermal = np.roll(thermal, (round(shift[1] * FINE), round(shift[0] * FINE)), axis=(0, 1))
        thermal = ndimage.gaussian_filter(thermal, 1.5 * FINE)  # thermal cameras are less sharp
        rgb, thermal = (i.reshape(96, FINE, 128, FINE, -1).mean(axis=(1, 3)) for i in (rgb, thermal))
        noisy = (image + rng.normal(0, noise, image.shape) for image in (rgb, thermal))
        pairs.append(ViewPair(*(image.astype(np.float32) for image in noisy)))
    return pairs


@pytest.mark.parametrize("shift", [(0.0, 0.0), (1.25, -0.75), (-3.5, 2.25)])
def test_known_shift_is_found(shift):
    offset = edge_offset(made_pairs(shift))
    assert isinstance(offset, Offset) and offset.views == 5
    assert (offset.x, offset.y) == pytest.approx(shift, abs=0.25)
    assert np.hypot(offset.x - shift[0], offset.y - shift[1]) <= max(offset.spread, 0.15)
    assert offset.px == pytest.approx(np.hypot(offset.x, offset.y))


def test_an_offset_beyond_the_first_search_is_found():
    """16 px are searched first, and then 19."""
    offset = edge_offset(made_pairs((17.5, -2.0), views=8))
    assert isinstance(offset, Offset) and (offset.x, offset.y) == pytest.approx((17.5, -2.0), abs=0.3)
    assert isinstance(edge_offset(made_pairs((28.0, 0.0), views=8)), str)


def test_wide_images_are_searched_without_wrapping():
    rng, pairs = np.random.default_rng(0), []
    for _ in range(5):
        world = (ndimage.gaussian_filter(rng.random((100, 1200, 1)), (2, 2, 0)) > 0.5).astype(np.float32)
        pairs.append(ViewPair(np.repeat(world[:, 100:1100], 3, axis=2), 1 - world[:, 40:1040]))
    offset = edge_offset(pairs)
    assert isinstance(offset, Offset) and (offset.x, offset.y) == pytest.approx((60, 0), abs=0.3)


def test_unrelated_images_have_no_offset():
    pairs = made_pairs((0.0, 0.0), views=6)
    mixed = [ViewPair(a.rgb, b.thermal) for a, b in zip(pairs, pairs[1:] + pairs[:1], strict=True)]
    assert isinstance(edge_offset(mixed), str)


def test_flat_images_and_few_views_have_no_offset():
    flat = ViewPair(np.full((100, 120, 3), 0.5, np.float32), np.full((100, 120, 1), 0.5, np.float32))
    assert isinstance(edge_offset([flat] * 4), str)
    small = ViewPair(*(image[:40, :60] for image in flat[:2]))
    assert "60×40 px are too small" in edge_offset([small] * 4)
    assert "2 views" in edge_offset(made_pairs((0, 0), views=2))
    assert isinstance(edge_offset([]), str)


def test_edges_of_masks_do_not_count():
    """A hidden border that is the same in all thermal images has strong edges, which do not move with the scene."""
    pairs = []
    for one in made_pairs((2.0, -1.0)):
        valid = np.ones(one.thermal.shape[:2], bool)
        valid[:20], valid[:, :25] = False, False
        pairs.append(ViewPair(one.rgb, np.where(valid[..., None], one.thermal, 0), valid))
    offset = edge_offset(pairs)
    assert (offset.x, offset.y) == pytest.approx((2, -1), abs=0.3)

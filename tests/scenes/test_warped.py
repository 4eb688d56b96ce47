import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from tdgbench.scenes import SceneError
from tdgbench.scenes.layouts.thermalmix import BLOCK, WarpedPictures, filler_below, is_picture
from tdgbench.scenes.scene import TemperatureRange
from tdgbench.scenes.temperature import Radiometry

H, W = 120, 160
RANGE = Radiometry(TemperatureRange(20.0, 45.5))  # 0.1 °C a level


def levels(number: int, lowest: int = 30) -> np.ndarray:
    """A textured image (H, W) uint8 of levels from `lowest` to 230, as of view `number`."""
    texture = ndimage.gaussian_filter(np.random.default_rng(number).normal(size=(H, W)), 3)
    texture = (texture - texture.min()) / np.ptp(texture)
    return np.round(lowest + (230 - lowest) * texture).astype(np.uint8)


def decoded(image: np.ndarray, quality: int) -> np.ndarray:
    """The image as a JPEG keeps it."""
    file = io.BytesIO()
    Image.fromarray(image).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file)).astype(np.float32) / 255


def warped(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The image with black left of an oblique edge, of which a column is mixed; and the pixels with black in them."""
    y, x = np.mgrid[:H, :W]
    edge = 11 + y // 6
    image = np.where(x < edge, 0, np.where(x == edge, image * 0.6, image)).astype(np.uint8)
    return image, x <= edge


@pytest.mark.parametrize("quality", [60, 75, 95])
@pytest.mark.parametrize("number", range(3))
def test_all_that_a_filler_spoils_is_masked_and_no_more(quality, number):
    """Outside the mask, an image is exactly what it is without a filler."""
    image = levels(number)
    with_filler, has_filler = warped(image)
    alone, shown = decoded(image, quality), decoded(with_filler, quality)
    mask = filler_below(shown, alone.min(), BLOCK)
    assert mask[has_filler].all() and np.array_equal(shown[~mask], alone[~mask])
    assert (mask & ~ndimage.binary_dilation(has_filler, iterations=BLOCK + 1, structure=np.ones((3, 3)))).sum() == 0
    assert not np.array_equal(shown[~has_filler], alone[~has_filler])  # so growing was needed


@pytest.mark.parametrize("quality", [50, 75, 95])
@pytest.mark.parametrize("lowest", [4, 10, 60])
def test_noise_below_the_minimum_is_no_filler(quality, lowest):
    """A cold wall around a warm object: JPEG moves many pixels below the minimum of another JPEG of it."""
    warm = np.hypot(*np.mgrid[-H // 2 : H // 2, -W // 2 : W // 2]) < 30
    wall = np.random.default_rng(0).integers(lowest, lowest + 3, (H, W))
    image = np.where(warm, 200, wall).astype(np.uint8)
    shown, before = decoded(image, quality), decoded(image[:, ::-1][5:-3, 9:-3], 95)
    assert not filler_below(np.roll(shown, 3, axis=1), before.min(), BLOCK).any()


def test_holes_of_a_warp_are_masked():
    image = levels(0)
    image[50:60, 70:82] = 0
    mask = filler_below(image / 255, 30 / 255, block=1)
    assert mask[49:61, 69:83].all() and mask.sum() == 12 * 14


@pytest.fixture
def write(tmp_path):
    """Write a warped image and the one before the warp, of another size; the path of the first."""

    def act(image, before=None, suffix=".png", **options) -> Path:
        for folder, content in (("warped_thermal", image), ("thermal", before)):
            (tmp_path / folder).mkdir(exist_ok=True)
            if content is not None:
                Image.fromarray(content).save(tmp_path / folder / f"v{suffix}", **options)
        return tmp_path / "warped_thermal" / f"v{suffix}"

    return act


def reader(path: Path, mask: bool = True) -> WarpedPictures:
    before = path.parents[1] / "thermal" / path.name
    return WarpedPictures(RANGE, {path.stem: before} if before.exists() else {}, mask)


def test_temperatures(write):
    image, has_filler = warped(levels(0))
    path = write(image, levels(0).repeat(2, axis=1))
    one = reader(path)(path)
    truth = 20 + 0.1 * levels(0)
    assert one.values.dtype == np.float32 and one.is_masked and one.block == 1
    measured = np.isfinite(one.values)
    assert not measured[has_filler].any() and np.abs(one.values - truth)[measured].max() < 1e-4
    assert measured[~ndimage.binary_dilation(has_filler, iterations=2)].all()


def test_raised_as_the_authors_do(write):
    """Source: mert-o/ThermalNeRFs e1d4e26, img_temp_mapper.py."""
    image, _ = warped(levels(1))
    path = write(image, levels(1, lowest=40)[:60])
    one = reader(path, mask=False)(path)
    t = np.maximum(image / 255, levels(1, lowest=40)[:60].min() / 255)
    assert not one.is_masked and np.allclose(one.values, 20 + t * 25.5, atol=1e-5)


def test_what_tells_nothing_is_left_to_the_search(write):
    """No image before the warp; or one that is nearly black somewhere."""
    image, _ = warped(levels(0))
    path = write(image, suffix=".jpg", quality=95)
    one = reader(path)(path)
    assert not one.is_masked and np.isfinite(one.values).all() and one.block == BLOCK
    path = write(image, levels(0, lowest=2))
    one = reader(path)(path)
    assert not one.is_masked and one.values.min() == np.float32(20 + 0.1 * 2)


def test_gray_in_three_channels_and_colours(write):
    gray = levels(0)
    path = write(np.stack([gray] * 3, axis=-1))
    assert np.allclose(reader(path)(path).values, 20 + 0.1 * gray, atol=1e-4)
    path = write(np.stack([gray, gray, 255 - gray], axis=-1))
    with pytest.raises(SceneError, match=r"v\.png is in colours, but temperatures are read from gray images"):
        reader(path)(path)


def test_arrays_are_no_pictures(tmp_path):
    degC = np.full((4, 6), 30.0)
    np.save(tmp_path / "v.npy", degC)
    path = tmp_path / "v.npy"
    assert not is_picture(path) and np.array_equal(reader(path)(path).values, degC)

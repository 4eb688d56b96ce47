import numpy as np
import pycolmap
import pytest

from tdgbench.data.prepare.resample import from_file, inside_photo, make_grid, no_distortion, same_view
from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import PhotoMapping

RGB, THERMAL = (320, 240), (160, 120)


def pattern(x, y):
    """A smooth function of RGB pixel positions (centres at integers + 1/2), in 0 to 1."""
    return 0.5 + 0.25 * np.sin(x / 17) + 0.25 * np.cos(y / 13)


def positions(size):
    return np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)


def images(mapping):
    """RGB and thermal images of one pattern: the thermal camera's pixels lie where the mapping says."""
    rgb = np.repeat(pattern(*positions(RGB))[..., None], 3, axis=2).astype(np.float32)
    x, y = positions(THERMAL)
    back = np.linalg.inv(mapping.thermal_from_rgb) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    return rgb, pattern(back[0].reshape(x.shape), back[1].reshape(x.shape))


@pytest.mark.parametrize("distortion", [0.0, 0.08])
@pytest.mark.parametrize("stated", [None, PhotoMapping(1.25, -6, 9)])
def test_both_modalities_are_resampled_alike(distortion, stated):
    source = pycolmap.Camera(model="SIMPLE_RADIAL", width=320, height=240, params=[280, 160, 120, distortion])
    mapping = same_view(RGB, THERMAL) if stated is None else inside_photo(stated, RGB, THERMAL, "test")
    grid = make_grid(source, mapping, THERMAL)
    rgb, thermal = images(mapping)
    warped, valid = grid.thermal(thermal, mapping)
    inner = valid.copy()
    inner[:2], inner[-2:], inner[:, :2], inner[:, -2:] = False, False, False, False
    assert valid.mean() > 0.95
    assert np.abs(grid.rgb(rgb)[..., 0] - warped)[inner].max() < 0.01
    # Where the output's camera sees a ray, the distorted camera saw the same ray.
    x, y = positions(grid.size)
    rays = np.stack([(x - grid.K[0, 2]) / grid.K[0, 0], (y - grid.K[1, 2]) / grid.K[1, 1]], axis=-1).reshape(-1, 2)
    seen = source.img_from_cam(np.concatenate([rays, np.ones((len(rays), 1))], axis=1)).reshape(*x.shape, 2)
    assert np.abs(pattern(seen[..., 0], seen[..., 1]) - warped)[inner].max() < 0.01


def test_output_has_the_thermal_resolution_and_never_more_than_rgb():
    assert make_grid(no_distortion(RGB), same_view(RGB, THERMAL), THERMAL).size == THERMAL
    assert make_grid(no_distortion(RGB), same_view(RGB, (640, 480)), (640, 480)).size == RGB
    half = inside_photo(PhotoMapping(2.0, 0, 0), RGB, THERMAL, "test")
    assert make_grid(no_distortion(RGB), half, THERMAL).size == (160, 120)  # half of the RGB image, at its resolution
    with pytest.raises(SceneError, match="would be 12×9 px"):
        make_grid(no_distortion(RGB), same_view(RGB, (12, 9)), (12, 9))


def test_invalid_pixels_are_told_and_filled():
    grid = make_grid(no_distortion(RGB), same_view(RGB, RGB), RGB)
    thermal = np.full((240, 320), 20.0)
    thermal[100:110, 50:60] = np.nan
    filled, valid = grid.thermal(thermal, same_view(RGB, RGB))
    assert not valid[100:110, 50:60].any() and (~valid).sum() <= 12 * 12 and np.allclose(filled, 20)


def test_thermal_image_beyond_the_rgb_image():
    wide = inside_photo(PhotoMapping(0.5, 0, 0), RGB, THERMAL, "test")  # twice as wide as the RGB image
    grid = make_grid(no_distortion(RGB), wide, THERMAL)
    assert grid.size == (80, 60) and grid.thermal(np.ones((120, 160)), wide)[1].all()
    beside = inside_photo(PhotoMapping(4.0, 300, 0), RGB, THERMAL, "test")
    with pytest.raises(SceneError, match="outside of the RGB image"):
        make_grid(no_distortion(RGB), beside, THERMAL)


def at(mapping, x, y):
    row, column = mapping.indices(np.array(y - 0.5), np.array(x - 0.5))
    return float(column + 0.5), float(row + 0.5)


def test_same_view():
    mapping = same_view((640, 480), (320, 240))
    assert at(mapping, 0, 0) == (0, 0) and at(mapping, 640, 480) == (320, 240)
    assert "same field of view" in mapping.assumption
    assert "pixel by pixel" in same_view((64, 48), (64, 48)).assumption
    with pytest.raises(SceneError, match="--mapping RATIO X Y"):
        same_view((640, 480), (640, 512))


def test_inside_photo():
    """The thermal image's centre lies off the photo's by the offset; its width is 1 / ratio of the photo's."""
    mapping = inside_photo(PhotoMapping(1.25, -10, 20), (1000, 800), (400, 320), "a test")
    assert at(mapping, 500 - 10, 400 + 20) == pytest.approx((200, 160))
    assert at(mapping, 490 - 400, 420) == pytest.approx((0, 160)) and at(mapping, 490 + 400, 420) == pytest.approx(
        (400, 160)
    )
    assert "parallax" in mapping.assumption
    for stated in (PhotoMapping(0, 0, 0), PhotoMapping(float("nan"), 0, 0), PhotoMapping(1.2, 5000, 0)):
        with pytest.raises(SceneError, match="a test"):
            inside_photo(stated, (1000, 800), (400, 320), "a test")


def test_homography_of_opencv(tmp_path):
    """OpenCV's pixel centres are at integers: its (0, 0) is (0.5, 0.5) here."""
    (tmp_path / "H.txt").write_text("0.5 0 3\n0, 0.5, -1\n0 0 1\n")
    mapping = from_file(tmp_path / "H.txt")
    assert at(mapping, 0.5, 0.5) == pytest.approx((3.5, -0.5))
    assert at(mapping, 10.5, 0.5) == pytest.approx((8.5, -0.5))
    for text in ("1 0 0 0 1 0", "1 0 0 0 1 0 0 0 x", "0 0 0 0 0 0 0 0 0", "1 0 0 0 1 0 0 0 nan"):
        (tmp_path / "H.txt").write_text(text)
        with pytest.raises(SceneError, match=r"H\.txt must hold the 9 numbers"):
            from_file(tmp_path / "H.txt")

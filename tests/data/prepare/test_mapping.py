import numpy as np
import pytest

from tdgbench.data.prepare.mapping import from_file, inside_photo, same_view
from tdgbench.scenes import SceneError
from tdgbench.scenes.radiometric import PhotoMapping


def at(mapping, x, y):
    return tuple(float(v) for v in mapping.apply(np.array(x), np.array(y)))


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

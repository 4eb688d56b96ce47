import numpy as np
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.formats import decode, header, read_celsius
from tdgbench.scenes.temperature import CountScale
from tests.helpers.flir import with_segments

COUNTS = np.random.default_rng(0).integers(3000, 9000, (24, 32)).astype("<u2")


def write(path, size=(32, 24), **segments):
    """A JPEG of DJI with raw data in APP segments."""
    Image.new("L", size, 90).save(path)
    parts = [b"\xff\xe1\x00\x20" + b"Exif\0\0MM DJI".ljust(30, b"\0")]
    for name, raw in segments.items():
        marker = bytes([0xFF, 0xE0 + int(name[3:])])
        parts.append(marker + (len(raw) + 2).to_bytes(2, "big") + raw)
    path.write_bytes(with_segments(path.read_bytes(), parts))
    return path


def test_counts_under_pictures_of_their_size_and_of_a_multiple(tmp_path):
    for size, segments in (
        ((32, 24), {"APP3": COUNTS.tobytes()}), ((64, 48), {"APP3": COUNTS.tobytes()}),
        ((32, 24), {"APP3": bytes(8), "APP4": COUNTS.tobytes()}),
    ):  # fmt: skip
        path = write(tmp_path / "a.jpg", size, **segments)
        assert np.array_equal(decode(path).values[..., 0], COUNTS)
        found = header(path)
        assert found[1:5] == (32, 24, "16-bit", "counts")
        assert ("under a picture of 64×48" in str(found)) == (size[0] == 64)
        assert np.allclose(read_celsius(path, CountScale(0.02, -50)), COUNTS * 0.02 - 50)
        assert decode(path, as_picture=True).values.shape == (size[1], size[0], 1)


def test_counts_without_a_scale_name_the_remedy(tmp_path):
    with pytest.raises(SceneError, match=r"a\.jpg holds counts, which only DJI's SDK .* write float TIFF"):
        read_celsius(write(tmp_path / "a.jpg", APP3=COUNTS.tobytes()))
    with pytest.raises(SceneError, match=r"b\.jpg has 100 bytes of raw data for 32×24 pixels"):
        decode(write(tmp_path / "b.jpg", APP3=bytes(100)))

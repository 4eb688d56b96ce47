import json

import numpy as np
import pytest
from PIL import Image

from tdgbench.scenes import SceneError
from tdgbench.scenes.images import Radiometry, is_gray, read_image, read_radiometry, resize
from tdgbench.scenes.scene import TemperatureRange

RANGE = Radiometry(TemperatureRange(10.0, 60.0), degC_per_count=0.01, degC_at_zero=-273.15)


def test_8_bit(tmp_path):
    values = np.arange(12, dtype=np.uint8).reshape(3, 4) * 20
    Image.fromarray(values).save(tmp_path / "gray.png")
    gray = read_image(tmp_path / "gray.png")
    assert gray.shape == (3, 4, 1) and gray.dtype == np.float32 and np.allclose(gray[..., 0], values / 255)
    Image.fromarray(np.stack([values] * 3, axis=-1)).save(tmp_path / "color.png")
    color = read_image(tmp_path / "color.png")
    assert color.shape == (3, 4, 3) and is_gray(color)
    Image.fromarray(np.stack([values, values, values // 2], axis=-1)).save(tmp_path / "other.png")
    assert not is_gray(read_image(tmp_path / "other.png"))


@pytest.mark.parametrize("suffix", [".png", ".tiff"])
def test_16_bit_radiometric(tmp_path, suffix):
    degC = np.array([[10.0, 20.0], [35.0, 70.0]])
    counts = np.round((degC + 273.15) / 0.01).astype(np.uint16)
    Image.fromarray(counts).save(tmp_path / f"t{suffix}")
    image = read_image(tmp_path / f"t{suffix}", RANGE)
    assert np.allclose(image[..., 0], [[0, 0.2], [0.5, 1.0]], atol=1e-6)
    assert np.allclose(read_image(tmp_path / f"t{suffix}")[..., 0], counts / 65535)


def test_float_tiff_is_degC(tmp_path):
    Image.fromarray(np.array([[10.0, 35.0]], np.float32)).save(tmp_path / "t.tiff")
    assert np.allclose(read_image(tmp_path / "t.tiff", RANGE)[..., 0], [[0, 0.5]])
    with pytest.raises(SceneError, match=r"t\.tiff holds temperatures; add temperature\.json"):
        read_image(tmp_path / "t.tiff")


def test_a_broken_image_is_named(tmp_path):
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n broken")
    with pytest.raises(SceneError, match=r"bad\.png cannot be read"):
        read_image(tmp_path / "bad.png")


def test_radiometry_file(tmp_path):
    path = tmp_path / "temperature.json"
    assert read_radiometry(path) is None
    path.write_text(json.dumps({"min": 16.8, "max": 48.3}))
    assert read_radiometry(path) == Radiometry(TemperatureRange(16.8, 48.3))
    for bad in ('{"min": 3}', '{"min": 5, "max": 4}', "[]", "nonsense"):
        path.write_text(bad)
        with pytest.raises(SceneError, match=r"temperature\.json must hold"):
            read_radiometry(path)


def test_resize_averages_areas():
    image = np.random.default_rng(0).random((6, 8, 3)).astype(np.float32)
    expected = image.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    assert np.allclose(resize(image, 4, 3), expected, atol=1e-6)
    assert resize(image, 8, 6) is image

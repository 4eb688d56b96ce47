from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from benchmarks.fuzz.colmap_model import MalformedError
from benchmarks.fuzz.strict import png_problem, read_npy, read_temperatures


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "I;16"])
def test_a_png_is_whole_or_not(tmp_path, mode):
    path = tmp_path / "a.png"
    gray = np.arange(32 * 24, dtype=np.uint16).reshape(24, 32)
    (Image.fromarray(gray) if mode == "I;16" else Image.new("RGB", (32, 24), (9, 99, 199)).convert(mode)).save(path)
    data = path.read_bytes()
    assert png_problem(data) == ""
    for at in range(8, data.index(b"IEND") - 4):
        changed = bytearray(data)
        changed[at] ^= 1
        assert png_problem(bytes(changed)), at
        assert png_problem(data[:at]), at


@pytest.mark.parametrize("values", [np.ones((2, 3), np.float32), np.ones((3,), ">i4"), np.asfortranarray(np.eye(3))])
def test_arrays(tmp_path, values):
    path = tmp_path / "a.npy"
    np.save(path, values)
    np.testing.assert_array_equal(read_npy(path), values)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(MalformedError):
        read_npy(path)


def test_arrays_of_objects_are_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.array([{}], object), allow_pickle=True)
    with pytest.raises(MalformedError, match="not an array of numbers"):
        read_npy(tmp_path / "a.npy")


@pytest.mark.parametrize(
    "content", ["", "[]", '{"min": 0}', '{"min": 1, "max": 1}', '{"min": 0, "max": NaN}', "[" * 10**5]
)
def test_temperatures(tmp_path, content):
    path = tmp_path / "temperature.json"
    path.write_text('{"min": 0, "max": 40}')
    assert read_temperatures(path) == [0.0, 40.0]
    path.write_text(content)
    with pytest.raises(MalformedError):
        read_temperatures(path)

import math
import struct

import numpy as np
import pycolmap
import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import read_model
from tests.helpers.models import copied, put

WIDTH, HEIGHT, FOCAL, CENTRE, DISTORTION = 16, 24, 32, 40, 56  # bytes of cameras.bin, in its first row


@pytest.mark.parametrize(
    ("at", "form", "value", "message"),
    [
        (FOCAL, "<d", math.nan, "has parameters that are not finite"),
        (FOCAL, "<d", -60.0, "has the focal length -60 px; it must be positive"),
        (FOCAL, "<d", 0.0, "has the focal length 0 px; it must be positive"),
        (FOCAL, "<d", 1e-3, "a field of view of 180°; it must be 1° to 179°"),
        (FOCAL, "<d", 1e6, "it must be 1° to 179°"),
        (CENTRE, "<d", -1e5, "has its principal point at -100000 px of 64 px"),
        (DISTORTION, "<d", math.inf, "has parameters that are not finite"),
        (WIDTH, "<Q", 0, "is 0×48 px; it must have 1 to"),
        (HEIGHT, "<Q", 2**63, "it must have 1 to 89478485 pixels"),
        (12, "<i", 17, "which no pinhole can show"),
        (12, "<i", 99, "camera 1 of 4 (byte 8) has an unknown model id 99"),
    ],
)
def test_numbers_that_are_no_camera(models, tmp_path, at, form, value, message):
    folder = copied(models["bin"], tmp_path / "model")
    if value == 17:  # COLMAP's model of two parameters, here the only camera
        data = (folder / "cameras.bin").read_bytes()
        row = struct.pack("<IiQQ2d", 1, 17, 64, 32, 64, 32)
        (folder / "cameras.bin").write_bytes(data[:8] + row + data[64:])
    else:
        put(folder / "cameras.bin", at, form, value)
    with pytest.raises(SceneError) as error:
        read_model(folder)
    assert message in str(error.value) and "cameras.bin" in str(error.value)


@pytest.mark.parametrize("params", [[-30.0, 0, 0, 0], [0, 1e6, 0, 0], [0, 0, 5.0, 5.0], [1e200, -1e200, 0, 0]])
def test_absurd_distortion_is_refused(tmp_path, params):
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(model="OPENCV", width=120, height=90, params=[80, 80, 60, 45, *params], camera_id=1)
    model.add_camera_with_trivial_rig(camera)
    model.add_image_with_trivial_frame(pycolmap.Image(name="v.png", camera_id=1, image_id=1), pycolmap.Rigid3d())
    model.write_binary(str(tmp_path))
    with pytest.raises(SceneError, match=r"cameras\.bin: camera 1") as error:
        _ = read_model(tmp_path).images["v"].undistortion.positions
    assert "Correct the model" in str(error.value)


def test_blocks_give_the_same_positions(models, monkeypatch):
    whole = next(iter(read_model(models["bin"]).images.values())).undistortion.positions
    monkeypatch.setattr("tdgbench.scenes.colmap.pinhole.BLOCK", 100)
    blocks = next(iter(read_model(models["bin"]).images.values())).undistortion.positions
    assert np.array_equal(whole[0], blocks[0]) and np.array_equal(whole[1], blocks[1])

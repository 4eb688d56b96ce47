"""Numbers and references of a model that is whole, but wrong."""

import math
import shutil
import struct

import numpy as np
import pycolmap
import pytest

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import read_model
from tests.helpers.models import copied, put

QUATERNION, TRANSLATION = 12, 44  # bytes of images.bin, in its first row


@pytest.fixture
def old(models, tmp_path):
    """A binary model as COLMAP before 3.12 writes it, which a test may change."""
    return copied(models["bin without frames"], tmp_path / "old")


@pytest.fixture
def new(models, tmp_path):
    """A binary model with rigs and frames, which a test may change."""
    return copied(models["bin"], tmp_path / "new")


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("at", [QUATERNION, TRANSLATION])
def test_poses_that_are_not_finite(old, at, value):
    put(old / "images.bin", at, "<d", value)
    with pytest.raises(SceneError, match=r"images\.bin is damaged: the pose of image '.*' is not finite; copy"):
        read_model(old)


@pytest.mark.parametrize("quaternion", [(0, 0, 0, 0), (2, 0, 0, 0), (1, 0.1, 0, 0), (1e200, 1e200, 0, 0)])
def test_quaternions_that_are_no_rotations(old, quaternion):
    put(old / "images.bin", QUATERNION, "<4d", *quaternion)
    with pytest.raises(SceneError, match=r"the quaternion of image '.*' has length .*; it must be 1"):
        read_model(old)


def test_a_quaternion_that_is_nearly_1_long_makes_a_rotation(old):
    before = read_model(old)[0]
    quaternion = struct.unpack_from("<4d", (old / "images.bin").read_bytes(), QUATERNION)
    put(old / "images.bin", QUATERNION, "<4d", *(0.9995 * value for value in quaternion))
    after = read_model(old)[0]
    for name, one in before.items():
        np.testing.assert_allclose(
            after[name].camera.world_to_camera, one.camera.world_to_camera, rtol=0, atol=1e-14, err_msg=name
        )


def test_points_that_are_not_finite_are_named(new):
    put(new / "points3D.bin", 16, "<d", math.nan)
    beyond = r"points3D\.bin is damaged: 1 points are not finite or beyond 1e\+09 \(point \d+\)"
    with pytest.raises(SceneError, match=beyond):
        read_model(new)


@pytest.mark.parametrize(
    ("file", "word", "value", "message"),
    [
        ("images.txt", 8, "99", "has camera 99, which cameras.txt does not hold"),
        ("images.txt", 8, "x", "line 5 is no image: invalid literal for int() with base 10: 'x'"),
        ("points3D.txt", 4, "300", "out of its range"),
        ("points3D.txt", 1, "1_0", "line 4 is no point: it has a word that is no number"),
        ("cameras.txt", 0, "2", "two of its cameras have one id"),
        ("images.txt", 0, "2", "two of its images have one id"),
        ("cameras.txt", 1, "PINHOLES", "line 4 is no camera: PINHOLES with 4 parameters is no camera model"),
        ("cameras.txt", 4, "6O", "line 4 is no camera: could not convert string to float: '6O'"),
        ("cameras.txt", 4, "6_0", "line 4 is no camera: '6_0' is no number"),
    ],
)  # fmt: skip
def test_references_and_words_of_text_files(models, tmp_path, file, word, value, message):
    folder = copied(models["txt without frames"], tmp_path / "txt")
    lines = (folder / file).read_text().split("\n")
    row = next(i for i, line in enumerate(lines) if line and not line.startswith("#"))
    words = lines[row].split(" ")
    words[word] = value
    lines[row] = " ".join(words)
    (folder / file).write_text("\n".join(lines))
    with pytest.raises(SceneError) as error:
        read_model(folder)
    assert message in str(error.value) and str(folder / file) in str(error.value)


def test_names_that_no_file_could_have(models, tmp_path):
    for name in ("..", "a\\..", "a\nb.png", "x" * 300 + ".png", " .png"):
        folder = copied(models["bin without frames"], tmp_path / "old")
        data = (folder / "images.bin").read_bytes()
        end = data.index(b"\0", 72)
        (folder / "images.bin").write_bytes(data[:72] + name.encode() + data[end:])
        with pytest.raises(SceneError, match=r"images\.bin: image .* gives a view the name .*; rename it"):
            read_model(folder)
    shutil.rmtree(folder)


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

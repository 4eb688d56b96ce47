"""Numbers and references of a model that is whole, but wrong."""

import math
import shutil
import struct

import numpy as np
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


def test_a_pose_too_far_to_compute_with(old):
    put(old / "images.bin", TRANSLATION, "<d", 1e300)
    with pytest.raises(SceneError, match=r"images\.bin: image '.*' has a pose 1e\+300 from the origin"):
        read_model(old)


def test_points_that_are_not_finite_are_named(new):
    put(new / "points3D.bin", 16, "<d", math.nan)
    beyond = r"points3D\.bin is damaged: 1 points are not finite or beyond 1e\+09 \(point \d+\)"
    with pytest.raises(SceneError, match=beyond):
        read_model(new)


def test_images_and_frames_must_agree(new):
    (tx,) = struct.unpack_from("<d", (new / "images.bin").read_bytes(), TRANSLATION)
    put(new / "images.bin", TRANSLATION, "<d", tx + 0.01)
    with pytest.raises(SceneError, match=r"differs from that in images\.bin; .* delete rigs\.bin and frames\.bin"):
        read_model(new)


def test_rigs_and_frames_come_together(new):
    (new / "rigs.bin").unlink()
    with pytest.raises(SceneError, match=r"frames\.bin is damaged: rigs\.bin is missing beside it"):
        read_model(new)


def test_a_rig_s_camera_that_is_not_there(models, tmp_path):
    folder = copied(models["txt"], tmp_path / "txt")
    text = (folder / "rigs.txt").read_text()
    (folder / "rigs.txt").write_text(text.replace("CAMERA 2 ", "CAMERA 77 "))
    with pytest.raises(SceneError, match=r"rig \d has camera 77, which cameras\.txt does not hold"):
        read_model(folder)


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        ("images.txt", ("IMAGE", 0, "1", "2"), "holds image 2 twice"),
        ("images.txt", ("IMAGE", 8, None, "99"), "has camera 99, which cameras.txt does not hold"),
        ("points3D.txt", ("POINT", 8, None, "99"), "names image 99, which images.txt does not hold"),
        ("points3D.txt", ("POINT", 9, None, "999"), "names 2-D point 999 of image"),
        ("points3D.txt", ("POINT", 9, None, None), "which belongs to point"),
        ("points3D.txt", ("POINT", 4, None, "300"), "out of its range"),
        ("points3D.txt", ("POINT", 1, None, "1_0"), "line 4 has"),
        ("cameras.txt", ("CAMERA", 1, None, "PINHOLES"), "line 4 has an unknown camera model 'PINHOLES'"),
        ("cameras.txt", ("CAMERA", 4, None, "6O"), "line 4 has '6O' where a number is expected"),
    ],
)  # fmt: skip
def test_references_and_words_of_text_files(models, tmp_path, file, change, message):
    folder = copied(models["txt without frames"], tmp_path / "txt")
    _, word, _, value = change
    lines = (folder / file).read_text().split("\n")
    row = next(i for i, line in enumerate(lines) if line and not line.startswith("#"))
    words = lines[row].split(" ")
    words[word] = str(int(words[word]) ^ 1) if value is None else value
    lines[row] = " ".join(words)
    (folder / file).write_text("\n".join(lines))
    with pytest.raises(SceneError) as error:
        read_model(folder)
    assert message in str(error.value) and str(folder / file) in str(error.value)


def test_empty_points_with_observations(models, tmp_path):
    folder = copied(models["txt"], tmp_path / "txt")
    (folder / "points3D.txt").write_text("")
    with pytest.raises(SceneError, match=r"points3D\.txt is damaged: it holds no point, but image"):
        read_model(folder)


def test_names_that_no_file_could_have(models, tmp_path):
    for name in ("..", "a\\..", "a\nb.png", "x" * 300 + ".png", " .png"):
        folder = copied(models["bin without frames"], tmp_path / "old")
        data = (folder / "images.bin").read_bytes()
        end = data.index(b"\0", 72)
        (folder / "images.bin").write_bytes(data[:72] + name.encode() + data[end:])
        with pytest.raises(SceneError, match=r"images\.bin: image .* gives a view the name .*; rename it"):
            read_model(folder)
    shutil.rmtree(folder)

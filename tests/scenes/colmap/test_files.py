"""Damaged files of a model: one clear error each, in little time and memory."""

import random
import shutil
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import read_model
from tdgbench.scenes.colmap.text import read_points
from tests.helpers.models import FORMATS, copied

BINARY = ("cameras.bin", "images.bin", "points3D.bin")
TEXT = ("cameras.txt", "images.txt", "points3D.txt")


@pytest.mark.parametrize("kind", FORMATS)
def test_models_are_read_as_by_pycolmap(models, kind):
    read, expected = read_model(models[kind]), pycolmap.Reconstruction(str(models[kind]))
    assert len(read.images) == len(expected.images) == 12
    for image in expected.images.values():
        camera = read.images[Path(image.name).stem].camera
        assert np.array_equal(camera.world_to_camera[:3], image.cam_from_world().matrix())
        pinhole = pycolmap.undistort_camera(pycolmap.UndistortCameraOptions(), expected.cameras[image.camera_id])
        assert np.array_equal(camera.K, pinhole.calibration_matrix())
    points = [expected.points3D[i] for i in sorted(expected.points3D)]
    assert np.array_equal(read.points.points, [p.xyz for p in points])
    assert np.array_equal(read.points.colors, np.array([p.color for p in points], np.float32) / np.float32(255))


def test_binary_files_come_before_text(models, tmp_path):
    folder = copied(models["bin"], tmp_path / "both")
    for path in models["txt"].iterdir():
        shutil.copy(path, folder)
    (folder / "cameras.txt").write_text("nonsense")
    assert len(read_model(folder).images) == 12
    (folder / "points3D.bin").unlink()  # as pycolmap: then text
    with pytest.raises(SceneError, match=r"cameras\.txt is damaged: line 1 is no camera"):
        read_model(folder)


def boundaries(data: bytes, name: str) -> list[int]:
    """First bytes of some rows of a binary file of the tests' model, and of its count."""
    rows = {"cameras.bin": 56, "points3D.bin": 51, "images.bin": 64}[name]
    return sorted({0, 8, 8 + rows, 8 + 2 * rows, len(data) // 2, len(data) - rows, len(data) - 8, len(data)})


@pytest.mark.parametrize("name", BINARY)
def test_cut_files_and_absurd_counts(models, tmp_path, name):
    folder = copied(models["bin"], tmp_path / "model")
    whole = (folder / name).read_bytes()
    cuts = {at + step for at in boundaries(whole, name) for step in (-1, 0, 1)} - {len(whole)}
    damaged = [whole[:at] if at < len(whole) else whole + b"\0" for at in sorted(cuts) if at >= 0]
    damaged += [struct.pack("<Q", count) + whole[8:] for count in (0, 2**31, 2**63, 2**64 - 1)]
    if name == "points3D.bin":
        damaged.append(whole[:51] + struct.pack("<Q", 2**61) + whole[59:])  # the length of a track
    if name == "images.bin":
        damaged.append(whole[:72] + b"\xff" * (len(whole) - 72))
    for data in damaged:
        (folder / name).write_bytes(data)
        with pytest.raises(SceneError, match=r"copy or download the model again"):
            read_model(folder)


@pytest.mark.parametrize("name", TEXT)
def test_cut_text_files(models, tmp_path, name):
    folder = copied(models["txt"], tmp_path / "model")
    whole = (folder / name).read_bytes()
    body = whole.rindex(b"# ")
    for at in (body + 80, (body + len(whole)) // 2, len(whole) - 2, len(whole) - 1):
        (folder / name).write_bytes(whole[:at])
        with pytest.raises(SceneError, match=r"copy or download the model again"):
            read_model(folder)


@pytest.mark.parametrize("name", TEXT)
def test_text_files_cut_between_two_rows(models, tmp_path, name):
    folder = copied(models["txt"], tmp_path / "model")
    rows = (folder / name).read_text().splitlines(keepends=True)
    (folder / name).write_text("".join(rows[: -2 if name == "images.txt" else -1]))
    with pytest.raises(SceneError, match=rf"{name} is damaged: its header counts \d+ rows, but it has \d+; copy"):
        read_model(folder)


@seed(0)
@settings(
    max_examples=300, deadline=None, database=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)  # fmt: skip
@given(st.sampled_from(FORMATS), st.integers(0, 2**32), st.integers(1, 8))
def test_changed_bytes_give_a_model_or_one_error(models, tmp_path, kind, number, count):
    folder = copied(models[kind], tmp_path / "model")
    chosen = random.Random(number)
    path = chosen.choice(sorted(folder.iterdir()))
    data = bytearray(path.read_bytes())
    for _ in range(count):
        data[chosen.randrange(len(data))] = chosen.randrange(256)
    path.write_bytes(data)
    try:
        read = read_model(folder)
    except SceneError as error:
        assert str(folder) in str(error)
        str(error).encode()
    else:
        assert all(np.isfinite(one.camera.world_to_camera).all() for one in read.images.values())
        assert all(np.isfinite(one.camera.K).all() for one in read.images.values())
        assert read.points is None or np.isfinite(read.points.points).all()


def test_points_of_a_text_file_need_no_tracks(tmp_path):
    path = tmp_path / "points3D.txt"
    path.write_text("2 0 0 1 255 0 0 0.5\n1 0 0 1 0 0 9 0.5\n")
    read = read_points(path)
    assert read.ids.tolist() == [2, 1] and read.colors.tolist() == [[255, 0, 0], [0, 0, 9]]
    path.write_text("# points\n2 0 0 1 255 0 0 0.5\n\n1 0 0 1 0 0 9 0.5 7 0\t8  1\r\n")
    assert read_points(path).ids.tolist() == [2, 1]


@pytest.mark.parametrize("kind", ["bin", "txt"])
def test_poses_are_those_of_the_images_file(models, tmp_path, kind):
    folder = copied(models[kind], tmp_path / "model")
    for name in ("rigs", "frames"):
        (folder / f"{name}.{kind}").write_bytes(b"nonsense")
    for name, image in read_model(folder).images.items():
        expected = read_model(models[kind]).images[name].camera.world_to_camera
        assert np.array_equal(image.camera.world_to_camera, expected)

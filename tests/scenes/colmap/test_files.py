"""Damaged files of a model: one clear error each, in little time and memory."""

import random
import shutil
import struct
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from tdgbench.scenes import SceneError
from tdgbench.scenes.colmap import binary, read_model, text
from tdgbench.scenes.colmap.text import read_images, read_points
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


@pytest.mark.parametrize("kind", FORMATS)
def test_tracks_and_2d_points_are_those_of_pycolmap(models, kind):
    folder, suffix, reader = models[kind], kind[:3], binary if kind.startswith("bin") else text
    expected = pycolmap.Reconstruction(str(folder))
    images = reader.read_images(folder / f"images.{suffix}", observed=True)
    assert len(images) == 12 and not any(len(one.points) for one in reader.read_images(folder / f"images.{suffix}"))
    for image in images:
        seen = expected.images[image.id].points2D
        assert np.array_equal(image.points["xy"], [point.xy for point in seen])
        assert image.points["point"].tolist() == [point.point3D_id for point in seen]  # 2^64 - 1 without a point
    points = reader.read_points(folder / f"points3D.{suffix}")
    tracks = np.split(points.images, np.cumsum(points.lengths)[:-1])
    assert {*points.ids.tolist()} == {*expected.points3D}
    for number, track in zip(points.ids, tracks, strict=True):
        assert track.tolist() == [element.image_id for element in expected.points3D[number].track.elements]


WAYS = ("{row}\n", "\n{row}\n\n", "{row}\r\n\r\n", "{row}  \n# none\n", "{row}\r",
        "{row}\n\n\n10.5 11.5 -1 20 30 -1.0\n")  # fmt: skip


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("header", ["", "# Number of images: 12, mean observations per image: 0\n"])
def test_images_in_the_ways_people_write_them(models, tmp_path, way, header):
    expected = pycolmap.Reconstruction(str(models["txt"])).images.values()
    rows = []
    for image in expected:
        (x, y, z, w), at = image.cam_from_world().rotation.quat, image.cam_from_world().translation
        numbers = " ".join(map(repr, map(float, (w, x, y, z, *at))))
        rows.append(way.format(row=f"{image.image_id}\t{numbers} {image.camera_id} a  new  {image.name}"))
    path = tmp_path / "images.txt"
    path.write_text(header + "".join(rows), newline="")
    read = read_images(path, observed=True)
    assert [one.name for one in read] == [f"a  new  {image.name}" for image in expected]
    for one, image in zip(read, expected, strict=True):
        pose = image.cam_from_world()
        assert [*one.quaternion[1:], one.quaternion[0]] == pose.rotation.quat.tolist()
        assert one.translation == pose.translation.tolist()
        assert (one.id, one.camera_id) == (image.image_id, image.camera_id)
        shown = [[10.5, 11.5], [20, 30]] if "-1" in way else []
        assert one.points["xy"].tolist() == shown and (one.points["point"] == 2**64 - 1).all()


ROW = "1 1 0 0 0 0 0 0 1 a.png\n"


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (ROW + "2 1 0 0 0 0 0 0 1 10 20 30\n", "line 2 can be an image or 2-D points"),
        (ROW + "2 1 0 0 0 0 0 0 1\n", "line 2 can be an image or 2-D points"),
        ("# images\n10 20 -1\n", "line 2 has 2-D points, but there is no image before it"),
        (ROW + "10 20 -1\n\n30 40 -1\n", "line 4 has 2-D points, but there is no image before it"),
        (ROW + "10 20\n", "line 2 is no image: it has 2 words, not 10 or more; nor is it of 2-D points"),
        (ROW + "2 0.6 0.8", "line 2 is no image: it has 3 words"),
        (ROW + "10 20 -1 3O 40 -1\n", "line 2 is no image: it has 6 words"),
        (ROW.replace("a", "\xe4").encode("latin-1"), "line 1 is not UTF-8; copy .*, or save it as UTF-8"),
    ],
)
def test_lines_that_are_both_or_neither_of_an_image_and_2d_points(tmp_path, rows, message):
    path = tmp_path / "images.txt"
    path.write_bytes(rows if isinstance(rows, bytes) else rows.encode())
    with pytest.raises(SceneError, match=message):
        read_images(path)


def test_2d_points_of_whole_pixels_and_names_of_digits(tmp_path):
    path = tmp_path / "images.txt"
    path.write_text("1 1 0 0 0 0 0 0 1 0001\n10 20 5 30 40 -1 50 60 7 70 80 9\n2 1 0 0 0 0 0 0 1 0002\n")
    first, second = read_images(path, observed=True)
    assert (first.name, second.name) == ("0001", "0002") and len(second.points) == 0
    assert first.points["xy"].tolist() == [[10, 20], [30, 40], [50, 60], [70, 80]]
    assert first.points["point"].tolist() == [5, 2**64 - 1, 7, 9]


@pytest.mark.parametrize("header", [True, False])
def test_a_byte_order_mark(models, tmp_path, header):
    folder, expected = copied(models["txt"], tmp_path / "model"), read_model(models["txt"])
    for name in TEXT:
        lines = (folder / name).read_text().splitlines(keepends=True)
        kept = "".join(line for line in lines if header or line[0] != "#")
        (folder / name).write_text(kept, encoding="utf-8-sig")
    read = read_model(folder)
    assert [*read.images] == [*expected.images]
    for name, image in read.images.items():
        assert np.array_equal(image.camera.world_to_camera, expected.images[name].camera.world_to_camera)
        assert np.array_equal(image.camera.K, expected.images[name].camera.K)
    assert np.array_equal(read.points.points, expected.points.points)


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
    rows = whole.splitlines(keepends=True)
    (folder / name).write_bytes(b"".join(rows[: -2 if name == "images.txt" else -1]))
    with pytest.raises(SceneError, match=rf"{name} is damaged: its header counts \d+ rows, but it has \d+; copy"):
        read_model(folder)


def test_binary_files_come_before_text(models, tmp_path):
    folder = copied(models["bin"], tmp_path / "both")
    for path in models["txt"].iterdir():
        shutil.copy(path, folder)
    (folder / "cameras.txt").write_text("nonsense")
    assert len(read_model(folder).images) == 12


@seed(0)
@settings(max_examples=100)
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
    path.write_text("2 0 0 1 255 0 0 0.5 7 0 8")
    with pytest.raises(SceneError, match="line 1 is no point: it has 11 words, not 8 and 2 for each image"):
        read_points(path)

"""Scenes of public captures, from made files in their formats."""

import io
import zipfile

import numpy as np
import pycolmap
import pytest
from PIL import Image

from benchmarks.captures import CAPTURES, checkout, dji_counts, write_scene
from benchmarks.geometry.metashape import read_project
from tdgbench.scenes import FolderDataset, ReadOptions

CHUNK = """<chunk><sensors><sensor id="0">
<calibration class="initial"><resolution width="640" height="512"/><f>700</f></calibration>
<calibration class="adjusted"><resolution width="640" height="512"/><f>741</f><cx>10</cx><cy>8</cy><k1>-0.03</k1>
<k2>0.2</k2><k3>0.1</k3><p1>0.008</p1><p2>0.003</p2></calibration></sensor></sensors>
<cameras><camera id="0" label="a"><transform>1 0 0 5 0 1 0 6 0 0 1 7 0 0 0 1</transform></camera>
<camera id="1" label="not aligned"/></cameras></chunk>"""


def project(folder, chunk):
    (folder / "0").mkdir()
    with zipfile.ZipFile(folder / "0" / "chunk.zip", "w") as archive:
        archive.writestr("doc.xml", chunk)
    return folder


def test_absent_checkout_says_what_to_clone(tmp_path):
    with pytest.raises(SystemExit, match=r"git clone https://github.com/chuckaustin/devilsRiver .*156557a"):
        checkout(tmp_path, CAPTURES["river"])


@pytest.mark.parametrize("name", ["chuckaustin+devilsRiver", "devilsRiver"])
def test_checkouts_have_either_name(tmp_path, name):
    (tmp_path / name).mkdir()
    assert checkout(tmp_path, CAPTURES["river"]) == tmp_path / name


def test_metashape_camera_is_opencv_with_tangential_terms_exchanged(tmp_path):
    camera, poses = read_project(project(tmp_path, CHUNK))
    assert camera.params.tolist() == [741, 741, 330, 264, -0.03, 0.2, 0.003, 0.008, 0.1, 0, 0, 0]
    assert list(poses) == ["a"] and poses["a"][:3, 3].tolist() == [5, 6, 7]


def test_metashape_terms_that_are_not_read_are_an_error(tmp_path):
    with pytest.raises(SystemExit, match=r"b1"):
        read_project(project(tmp_path, CHUNK.replace("<k1>-0.03</k1>", "<b1>1</b1>")))


def test_counts_of_dji_are_its_third_application_segments(tmp_path):
    counts = np.arange(48, dtype="<u2").reshape(6, 8)
    shown = io.BytesIO()
    Image.fromarray(np.zeros((6, 8), np.uint8)).save(shown, "JPEG")
    raw = counts.tobytes()
    segments = b"".join(b"\xff\xe3" + (len(part) + 2).to_bytes(2, "big") + part for part in (raw[:50], raw[50:]))
    path = tmp_path / "a.JPG"
    path.write_bytes(shown.getvalue()[:2] + segments + shown.getvalue()[2:])
    assert np.array_equal(dji_counts(path), counts)
    path.write_bytes(shown.getvalue())
    with pytest.raises(SystemExit, match="0 bytes"):
        dji_counts(path)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_scenes_are_read(tmp_path, dtype):
    rng = np.random.default_rng(0)
    frames = {f"v{k}": rng.integers(0, 200, (24, 32)).astype(dtype) for k in range(5)}
    model = pycolmap.Reconstruction()
    camera = pycolmap.Camera(camera_id=1, model="SIMPLE_RADIAL", width=32, height=24, params=[30, 16, 12, 0.01])
    model.add_camera_with_trivial_rig(camera)
    for number in range(4):  # one view is not registered
        image = pycolmap.Image(f"v{number}.png", camera_id=1, image_id=number + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.eye(3, 4) + [[0, 0, 0, number]] * 3))
    for point in rng.normal((0, 0, 9), size=(10, 3)):
        model.add_point3D(point, pycolmap.Track())
    write_scene(tmp_path / "made", frames, model)
    scene = FolderDataset(str(tmp_path), ReadOptions()).load("made")
    assert len(scene.train) + len(scene.test) == 4
    assert (scene.temperature is not None) == (dtype == np.float32)
    assert (scene.raw_count_range is not None) == (dtype == np.uint16)

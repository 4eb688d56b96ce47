"""What a cell's folder holds is read as it was written; files of another form are named."""

import hashlib

import numpy as np
import pytest
from PIL import Image

from tdgbench.cells.cameras import read_cameras, write_cameras
from tdgbench.cells.folder import CellFolder, hashes_below
from tdgbench.cells.paths import RECORD_FILE
from tests.helpers.records import record


def test_every_file_but_the_record_has_a_hash(tmp_path):
    (tmp_path / "renders").mkdir()
    names = ["cameras.json", "log.csv", "model.ply", "renders/v.png", "views.csv"]
    for name in (*names, RECORD_FILE):
        (tmp_path / name).write_bytes(b"")
    assert hashes_below(tmp_path) == dict.fromkeys(names, hashlib.sha256(b"").hexdigest())


def test_cameras_are_those_of_the_scene(small_scene, tmp_path):
    write_cameras(tmp_path, small_scene)
    for part, views in (("train", small_scene.train), ("test", small_scene.test)):
        found = read_cameras(tmp_path)[part]
        assert list(found) == [view.name for view in views]
        for view in views:
            camera = found[view.name]
            assert np.array_equal(camera.K, view.camera.K)
            assert np.array_equal(camera.world_to_camera, view.camera.world_to_camera)
            assert (camera.width, camera.height) == (view.camera.width, view.camera.height)


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"test": {"a": {"K": [1]}}}'])
def test_a_file_without_cameras_is_named(tmp_path, content):
    (tmp_path / "cameras.json").write_text(content)
    with pytest.raises(ValueError, match=r"cameras\.json holds no cameras"):
        read_cameras(tmp_path)


def test_masks(tmp_path):
    valid = np.random.default_rng(0).random((36, 48)) < 0.5
    cell = CellFolder(tmp_path, record())
    (tmp_path / "masks").mkdir()
    Image.fromarray(np.uint8(255) * valid).save(tmp_path / "masks" / "a.b.png")
    assert cell.has("masks", "a.b") and not cell.has("masks", "a")
    assert np.array_equal(cell.mask("a.b", (48, 36)), valid)
    with pytest.raises(ValueError, match=r"masks/a\.b\.png cannot be read: .*it is 48×36 px, its camera 36×48 px"):
        cell.mask("a.b", (36, 48))
    with pytest.raises(ValueError, match=r"masks/b\.png is missing"):
        cell.mask("b")

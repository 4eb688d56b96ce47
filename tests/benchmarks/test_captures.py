"""Scenes of public captures, from made files in their formats."""

from collections import Counter

import numpy as np
import pycolmap
import pytest

from benchmarks.captures import CAPTURES, checkout, write_scene
from tdgbench.data.prepare.sfm import Structure
from tdgbench.scenes import FolderDataset, PointCloud, ReadOptions


def test_absent_checkout_says_what_to_clone(tmp_path):
    with pytest.raises(SystemExit, match=r"git clone https://github.com/chuckaustin/devilsRiver .*156557a"):
        checkout(tmp_path, CAPTURES["river"])


@pytest.mark.parametrize("name", ["chuckaustin+devilsRiver", "devilsRiver"])
def test_checkouts_have_either_name(tmp_path, name):
    (tmp_path / name).mkdir()
    assert checkout(tmp_path, CAPTURES["river"]) == tmp_path / name


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_scenes_are_read(tmp_path, dtype):
    rng = np.random.default_rng(0)
    frames = {f"v{k}": rng.integers(0, 200, (24, 32)).astype(dtype) for k in range(5)}
    camera = pycolmap.Camera(camera_id=1, model="SIMPLE_RADIAL", width=32, height=24, params=[30, 16, 12, 0.01])
    poses = {
        f"v{k}.png": np.eye(4) + np.outer([1, 1, 1, 0], [0, 0, 0, k]) for k in range(4)
    }  # one view is not registered
    points = PointCloud(rng.normal((0, 0, 9), size=(10, 3)), np.zeros((10, 3), np.float32))
    write_scene(tmp_path / "made", frames, Structure(camera, poses, points, 0.5, [4], Counter(), Counter()))
    scene = FolderDataset(str(tmp_path), ReadOptions()).load("made")
    assert len(scene.train) + len(scene.test) == 4
    assert (scene.temperature is not None) == (dtype == np.float32)
    assert (scene.raw_count_range is not None) == (dtype == np.uint16)

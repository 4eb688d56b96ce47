import os

import pytest
from scipy.ndimage import maximum_filter, minimum_filter

from tdgbench.scenes import ReadOptions
from tdgbench.scenes.synthetic import SyntheticDataset
from tdgbench.scenes.synthetic.worlds import WORLDS
from tests.helpers.scenes import small_dataset


@pytest.mark.parametrize("name", WORLDS)
def test_depth_agrees_with_the_sparse_points(data_root, name):
    """Points, projected into a view, are at its depth there or hidden: cameras, depth and model agree."""
    scene = small_dataset(data_root).load(name)
    for view in scene.views[::4]:
        pixels, z = view.camera.project(scene.points.points)
        inside = (z > 0) & (pixels >= 1).all(axis=1) & (pixels[:, 0] < 47) & (pixels[:, 1] < 35)
        columns, rows = pixels[inside].astype(int).T
        near, far = minimum_filter(view.true_depth, 3)[rows, columns], maximum_filter(view.true_depth, 3)[rows, columns]
        assert (z[inside] > near * 0.97).mean() > 0.95  # nothing floats before the surfaces, but for outliers
        assert ((z[inside] > near * 0.97) & (z[inside] < far * 1.03)).mean() > 0.5


def test_same_seed_same_files(tmp_path):
    options = {"width": 24, "height": 18, "views": 5, "points": 50}
    first = SyntheticDataset(str(tmp_path / "a"), ReadOptions(), **options).load("night")
    again = SyntheticDataset(str(tmp_path / "b"), ReadOptions(), **options).load("night")
    other = SyntheticDataset(str(tmp_path / "c"), ReadOptions(), **options, seed=1).load("night")
    assert first.fingerprint == again.fingerprint != other.fingerprint


@pytest.mark.skipif(os.name == "nt", reason="Windows has no umask")
def test_permissions_follow_the_umask(tmp_path):
    before = os.umask(0o022)
    try:
        scene = SyntheticDataset(str(tmp_path), ReadOptions(), width=24, height=18, views=5, points=50).load("night")
    finally:
        os.umask(before)
    paths = [scene.folder, *scene.folder.rglob("*")]
    assert {path.stat().st_mode & 0o777 for path in paths if path.is_dir()} == {0o755}
    assert {path.stat().st_mode & 0o777 for path in paths if path.is_file()} == {0o644}
    assert [path.name for path in scene.folder.parent.iterdir()] == [scene.folder.name]


def test_a_scene_may_have_no_points(tmp_path):
    options = {"width": 24, "height": 18, "views": 5}
    for points in (0, 4):
        scene = SyntheticDataset(str(tmp_path), ReadOptions(), **options, points=points).load("night")
        assert scene.points is None and len(scene.train) == 4

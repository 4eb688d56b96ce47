import pytest

from tdgbench.scenes import ReadOptions, SceneError
from tdgbench.scenes.synthetic import SyntheticDataset


def test_unknown_scene(tmp_path):
    with pytest.raises(SceneError, match="no synthetic scene moon"):
        SyntheticDataset(str(tmp_path), ReadOptions()).load("moon")


def test_a_view_past_the_end_of_the_world_is_an_error(tmp_path):
    tall = SyntheticDataset(tmp_path, ReadOptions(), width=16, height=80, views=2)
    with pytest.raises(SceneError, match=r"pixels of a view show nothing.*dataset\.loader\.width"):
        tall.load("facade")
    assert list((tmp_path / "synthetic").iterdir()) == []


def test_a_root_that_is_no_folder_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(SceneError, match=r"no scene can be written to .*file \(Not a directory\); set data\.root=DIR"):
        SyntheticDataset(tmp_path / "file", ReadOptions()).load("orbit")

import pytest

from tdgbench.scenes import ReadOptions, SceneError
from tdgbench.scenes.synthetic import SyntheticDataset


def test_unknown_scene(tmp_path):
    with pytest.raises(SceneError, match="no synthetic scene moon"):
        SyntheticDataset(str(tmp_path), ReadOptions()).load("moon")

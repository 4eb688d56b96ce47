import shutil

import pytest


@pytest.fixture
def folder(small_scene, tmp_path):
    """A copy of a small scene that a test may change."""
    source = small_scene.train[0].thermal_path.parents[1]
    return shutil.copytree(source, tmp_path / "scene")

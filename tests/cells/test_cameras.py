import numpy as np
import pytest

from tdgbench.cells.cameras import read_cameras, write_cameras


def test_round_trip(small_scene, tmp_path):
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

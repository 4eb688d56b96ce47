import pytest

from tdgbench.scenes import FolderDataset, ReadOptions, SceneError
from tests.helpers.layouts import write_ti_nsd
from tests.helpers.scenes import load


def test_thermal_alone(small_gray_scene, tmp_path):
    scene = load(write_ti_nsd(small_gray_scene, tmp_path / "TI-NSD" / "building"), split="every_8th")
    assert [view.name for view in scene.test] == ["view000", "view008"] and scene.channels == 1
    assert scene.assumed["layout"] == "TI-NSD: images/<view>.png (thermal alone), sparse/0 (COLMAP)"
    with pytest.raises(SceneError, match="has no RGB image"):
        _ = scene.train[0].rgb
    dataset = FolderDataset(str(tmp_path), ReadOptions(), "ti_nsd")
    assert dataset.names() == ["building"] and dataset.load(None).dataset == "TI-NSD"


def test_without_images(small_gray_scene, tmp_path):
    folder = write_ti_nsd(small_gray_scene, tmp_path / "building")
    for path in (folder / "images").iterdir():
        path.unlink()
    with pytest.raises(SceneError, match=r"images holds no image; put one of each view there"):
        load(folder)

import shutil

import pytest

from tdgbench.scenes import FolderDataset, MissingScenesError, ReadOptions, RegisteredDataset, SceneError


def test_registered_scenes(folder, tmp_path):
    shutil.copytree(folder, tmp_path / "root" / "ThermalMix" / "Hands")
    dataset = RegisteredDataset(str(tmp_path / "root"), ReadOptions())
    assert dataset.load("Hand").name == "Hand" and dataset.load("Hand").group == "forward"
    assert dataset.missing(["Hand", "Face", "Truck"]) == ["Face", "Truck"]
    with pytest.raises(MissingScenesError) as error:
        dataset.load("Face")
    assert "ThermalMix" in str(error.value) and "Zenodo" in str(error.value) and "sparse/0" in str(error.value)
    with pytest.raises(SceneError, match="use dataset=thermalmix"):
        RegisteredDataset(str(tmp_path), ReadOptions(), "rgbt_scenes").load("Hand")


def test_a_folder_of_scenes(folder, tmp_path):
    dataset = FolderDataset(str(tmp_path), ReadOptions())
    assert dataset.names() == ["scene"] and dataset.load("scene").name == "scene"
    with pytest.raises(MissingScenesError, match="other not found"):
        dataset.load("other")

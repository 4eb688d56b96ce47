from pathlib import PurePosixPath

import pytest

from tdgbench.data.get.scenes import FILE, SceneRecord, by_scene, read_record, scene_folders
from tdgbench.data.get.sources import SOURCES, BadFileError
from tdgbench.scenes.errors import SceneError


def paths(*names: str) -> list[PurePosixPath]:
    return [PurePosixPath(name) for name in names]


@pytest.mark.parametrize(
    ("files", "folders"),
    [
        (["lion/warped_thermal/1.npy", "lion/colmap_sparse/0/cameras.bin"], ["lion"]),  # ThermalMix
        (["T/lion/warped_thermal/1.jpg", "T/panel/thermal/1.jpg", "T/lion/thermal/1.jpg"], ["T/lion", "T/panel"]),
        (
            ["R/Truck/rgb/train/1.jpg", "R/Truck/raw_images/1.jpg", "R/Dimsum/colmap/sparse/0/x"],
            ["R/Truck", "R/Dimsum"],
        ),
        (["T/facades/a/transforms.json", "T/objects/b/thermal/1.png"], ["T/facades/a", "T/objects/b"]),  # ThermoScenes
        (["images_4/1.jpg", "notes.txt"], ["."]),
        (["lion/depth/rgb/1.png", "lion/rgb/1.png"], ["lion"]),  # the inner folder comes first
        (["readme/1.txt", "rgb", "x/transforms.json/1"], []),  # names of another kind
    ],
)
def test_scene_folders(files, folders):
    assert scene_folders(paths(*files)) == paths(*folders)


def test_scenes_have_the_names_of_the_table():
    files = paths("Dark/rgb/1.jpg", "Tower/rgb/1.jpg")
    assert by_scene(SOURCES["rgbt_scenes"], files, "x", "a.zip") == {
        "DarkScenes": PurePosixPath("Dark"),
        "Tower": PurePosixPath("Tower"),
    }
    assert by_scene(SOURCES["thermoscenes"], paths("transforms.json"), "cup", "cup.zip") == {"cup": PurePosixPath()}


def test_two_scenes_of_one_name():
    with pytest.raises(BadFileError, match=r"a\.zip holds two scenes Lion: a/lion and b/Lion"):
        by_scene(SOURCES["thermalmix"], paths("a/lion/rgb/1.jpg", "b/Lion/rgb/1.jpg"), "x", "a.zip")


def test_a_record_is_read_as_it_was_written(tmp_path):
    assert read_record(tmp_path) is None
    record = SceneRecord("https://zenodo.org", {"lion.zip": "md5:0"}, ["Lion"])
    record.write(tmp_path)
    assert read_record(tmp_path) == record


def test_a_record_with_sums_of_files_is_read(tmp_path):
    """Earlier versions wrote them."""
    text = '{"page": "p", "downloads": {"a.zip": "md5:0"}, "scenes": ["A"], "files": {"1.jpg": {"size": 1}}}'
    (tmp_path / FILE).write_text(text, encoding="utf-8")
    assert read_record(tmp_path) == SceneRecord("p", {"a.zip": "md5:0"}, ["A"])


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"page": 1, "downloads": {}, "scenes": []}'])
def test_a_damaged_record(tmp_path, text):
    (tmp_path / FILE).write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=r"\.download\.json is damaged; remove it"):
        read_record(tmp_path)

from pathlib import PurePosixPath

import pytest

from tdgbench.data.get.errors import BadFileError
from tdgbench.data.get.scenes import by_scene, scene_folders
from tdgbench.data.get.sources import SOURCES


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

"""Which published files become which scenes, and how archives of them are unpacked."""

from pathlib import PurePosixPath

import pytest

from tdgbench.data.get.packages import packages_of, scenes_in, unpack
from tdgbench.data.get.sources import SOURCES, BadFileError, GetError, RemoteFile
from tests.helpers.archives import scene_files, zipped

SOURCE = SOURCES["thermalmix"]


def remote(*names: str, size: int = 1) -> list[RemoteFile]:
    return [RemoteFile(PurePosixPath(name), f"http://x/{name}", size, f"md5:{name}") for name in names]


def paths(*names: str) -> list[PurePosixPath]:
    return [PurePosixPath(name) for name in names]


def test_files_are_grouped():
    files = remote("lion.zip", "ThermalMix.ZIP", "hands/rgb/1.jpg", "hands/masks.zip", "pan.rar", "a/readme.md", ".x/y")
    packages, others = packages_of(SOURCE, files, [])
    assert [(one.name, one.scene, len(one.files), one.size) for one in packages] == [
        ("hands", "Hand", 2, 2), ("lion.zip", "Lion", 1, 1), ("ThermalMix.ZIP", None, 1, 1),
    ]  # fmt: skip
    assert others == paths("pan.rar", "a/readme.md")
    ((package,), _) = packages_of(SOURCE, remote("rgb/1.jpg", "sparse/0/cameras.bin", size=0), [])
    assert (package.name, package.scene, package.size) == ("ThermalMix", "ThermalMix", None)
    with pytest.raises(GetError, match="shows no scene and no zip archive to the public, but 1 other files"):
        packages_of(SOURCE, remote("pan.rar"), [])


def test_scenes_are_chosen_by_name_or_alias():
    files = remote("lion.zip", "panel.zip", "hand.zip")
    assert [one.name for one in packages_of(SOURCE, files, ["Hands", "PANEL"])[0]] == ["hand.zip", "panel.zip"]
    with pytest.raises(GetError, match=r"ThermalMix is of the scene Pan alone; published are lion\.zip, panel"):
        packages_of(SOURCE, files, ["pan"])


@pytest.mark.parametrize(
    ("files", "folders"),
    [
        (["lion/warped_thermal/1.npy", "lion/colmap_sparse/0/cameras.bin"], ["lion"]),  # ThermalMix
        (["T/lion/warped_thermal/1.jpg", "T/panel/thermal/1.jpg", "T/lion/thermal/1.jpg"], ["T/lion", "T/panel"]),
        (["R/Tree/rgb/train/1.jpg", "R/Tree/raw_images/1.jpg", "R/Car/colmap/sparse/0/x"], ["R/Tree", "R/Car"]),
        (["T/facades/a/transforms.json", "T/objects/b/thermal/1.png"], ["T/facades/a", "T/objects/b"]),  # ThermoScenes
        (["images_4/1.jpg", "notes.txt"], ["."]),
        (["lion/depth/rgb/1.png", "lion/rgb/1.png"], ["lion"]),  # the inner folder comes first
        (["readme/1.txt", "rgb", "x/transforms.json/1"], []),  # names of another kind
    ],
)
def test_scene_folders(files, folders):
    assert list(scenes_in(SOURCES["thermoscenes"], paths(*files), "x", "a.zip").values()) == paths(*folders)


def test_scenes_have_the_names_of_the_table():
    files = paths("Dark/rgb/1.jpg", "Tower/rgb/1.jpg")
    assert scenes_in(SOURCES["rgbt_scenes"], files, "x", "a") == {
        "DarkScenes": PurePosixPath("Dark"),
        "Tower": PurePosixPath("Tower"),
    }
    assert scenes_in(SOURCES["thermoscenes"], paths("transforms.json"), "cup", "a") == {"cup": PurePosixPath()}
    with pytest.raises(BadFileError, match=r"a\.zip holds two scenes Lion: a/lion and b/Lion"):
        scenes_in(SOURCE, paths("a/lion/rgb/1.jpg", "b/Lion/rgb/1.jpg"), "x", "a.zip")


def test_what_file_managers_leave_is_not_unpacked(tmp_path):
    files = scene_files("lion")
    junk = ("__MACOSX/lion/._1.jpg", "lion/.DS_Store", "lion/Thumbs.db", "lion/.download.json", "lion/empty/")
    (tmp_path / "a").write_bytes(zipped(files | dict.fromkeys(junk, b"")))
    assert unpack(tmp_path / "a", tmp_path / "out") == paths(*files)
    there = {p.relative_to(tmp_path / "out").as_posix(): p for p in (tmp_path / "out").rglob("*") if p.is_file()}
    assert {name: path.read_bytes() for name, path in there.items()} == files

import json
from pathlib import PurePosixPath

import pytest

from tdgbench.data.get.listing import RemoteFile, by_scene, list_files, packages_of
from tdgbench.data.get.sources import SOURCES, BadFileError, GetError
from tests.helpers.zenodo import Fault, zenodo

SOURCE = SOURCES["thermalmix"]
ENTRY = {"key": "lion.zip", "size": 5, "checksum": "md5:" + "0" * 32, "links": {"self": "https://zenodo.org/x"}}


@pytest.fixture
def server():
    with zenodo({"lion.zip": b"12345", "a b.txt": b""}) as one:
        yield one


def test_files_of_a_record(server):
    lion, text = list_files(SOURCE, server.address + "/")
    assert (str(lion.path), lion.size, lion.identity) == ("lion.zip", 5, "md5:827ccb0eea8a706c4c34a16891f84e7b")
    assert lion.address == f"{server.address}/api/records/1/files/lion.zip/content"
    assert (str(text.path), text.size) == ("a b.txt", 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"key": "../lion.zip"}, "'../lion.zip' leads out of its folder"),
        ({"key": 1}, r"files\.0\.key"),
        ({"size": -1}, r"files\.0\.size"),
        ({"size": "5"}, r"files\.0\.size"),
        ({"checksum": "sha256:0"}, r"files\.0\.checksum"),
        ({"links": {}}, "'self'"),
    ],
)
def test_entries_that_are_not_zenodos(server, change, message):
    server.listing = json.dumps({"files": [ENTRY | change]}).encode()
    with pytest.raises(GetError, match=f"the files of ThermalMix cannot be listed: .*{message}"):
        list_files(SOURCE, server.address)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"<html>maintenance</html>", "cannot be listed: .*Invalid JSON"),
        (b"{}", "cannot be listed: .*files"),
        (b"[" * 100_000, "cannot be listed: .*recursion"),
        (b'{"files": []}', "https://zenodo.org/records/11065834 shows no file to the public"),
    ],
)
def test_answers_that_are_no_list(server, answer, message):
    server.listing = answer
    with pytest.raises(GetError, match=message):
        list_files(SOURCE, server.address)


def test_a_record_that_is_gone(server):
    server.faults[""] = [Fault(status=410)]
    with pytest.raises(GetError, match="cannot be listed: 410 Client Error: Gone"):
        list_files(SOURCE, server.address)


@pytest.mark.parametrize("address", ["zenodo", "ftp://127.0.0.1", "http://"])
def test_no_address(address):
    with pytest.raises(GetError, match="the files of ThermalMix cannot be listed"):
        list_files(SOURCE, address)


def remote(*names: str, size: int | None = 1) -> list[RemoteFile]:
    return [RemoteFile(PurePosixPath(name), f"http://x/{name}", size, f"md5:{name}") for name in names]


def test_files_are_grouped():
    files = remote(
        "lion.zip", "ThermalMix.tar.gz", "hands/rgb/1.jpg", "hands/masks.zip", "pan.rar", "a/readme.md", ".x/y"
    )
    packages, others = packages_of(SOURCE, files)
    assert [(one.name, one.scene, len(one.files)) for one in packages] == [
        ("hands", "Hand", 2), ("lion.zip", "Lion", 1), ("ThermalMix.tar.gz", None, 1),
    ]  # fmt: skip
    assert others == [PurePosixPath("pan.rar"), PurePosixPath("a/readme.md")]
    assert [one.size for one in packages] == [2, 1, 1]


def test_a_published_folder_that_is_one_scene():
    ((package,), _) = packages_of(SOURCE, remote("rgb/1.jpg", "sparse/0/cameras.bin", size=None))
    assert (package.name, package.scene, package.size) == ("ThermalMix", "ThermalMix", None)


def test_scenes_are_chosen_by_name_or_alias():
    files = remote("lion.zip", "panel.zip", "hand.zip")
    assert [one.name for one in packages_of(SOURCE, files, ["Hands", "PANEL"])[0]] == ["panel.zip", "hand.zip"]
    with pytest.raises(GetError, match=r"ThermalMix is of the scene Pan alone; published are lion\.zip, panel"):
        packages_of(SOURCE, files, ["pan"])


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
    assert list(by_scene(SOURCES["thermoscenes"], paths(*files), "x", "a.zip").values()) == paths(*folders)


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

import json
from pathlib import PurePosixPath

import pytest

from tdgbench.data.get.listing import RemoteFile, chosen, list_files, sort_out
from tdgbench.data.get.sources import SOURCES, GetError
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
    with pytest.raises(GetError, match=f"the list of files of ThermalMix cannot be used: .*{message}"):
        list_files(SOURCE, server.address)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"<html>maintenance</html>", "cannot be used: .*Invalid JSON"),
        (b"{}", "cannot be used: .*files"),
        (b"[" * 100_000, "cannot be used: .*recursion"),
        (b'{"files": []}', "https://zenodo.org/records/11065834 shows no file to the public"),
    ],
)
def test_answers_that_are_no_list(server, answer, message):
    server.listing = answer
    with pytest.raises(GetError, match=message):
        list_files(SOURCE, server.address)


def test_the_list_is_asked_for_again(server):
    server.faults[""] = [Fault(status=503)]
    assert len(list_files(SOURCE, server.address)) == 2 and server.listings == 2


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
    found = sort_out(SOURCE, files)
    assert [(one.name, one.scene, len(one.files)) for one in found.packages] == [
        ("hands", "Hand", 2), ("lion.zip", "Lion", 1), ("ThermalMix.tar.gz", None, 1),
    ]  # fmt: skip
    assert found.others == [PurePosixPath("pan.rar"), PurePosixPath("a/readme.md")]
    assert [one.size for one in found.packages] == [2, 1, 1]


def test_a_published_folder_that_is_one_scene():
    (package,) = sort_out(SOURCE, remote("rgb/1.jpg", "sparse/0/cameras.bin", size=None)).packages
    assert (package.name, package.scene, package.size) == ("ThermalMix", "ThermalMix", None)


def test_scenes_are_chosen_by_name_or_alias():
    packages = sort_out(SOURCE, remote("lion.zip", "panel.zip", "hand.zip")).packages
    assert [one.name for one in chosen(SOURCE, packages, ["Hands", "PANEL"])] == ["panel.zip", "hand.zip"]
    with pytest.raises(GetError, match=r"ThermalMix is of the scene Pan alone; published are lion\.zip, panel"):
        chosen(SOURCE, packages, ["pan"])

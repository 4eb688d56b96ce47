"""Lists of published files: Zenodo's, from a server on this machine, and its faults."""

import json
from pathlib import PurePosixPath

import pytest

from tdgbench.data.get.sources import SOURCES, GetError, RemoteFile, list_files
from tests.helpers.zenodo import Fault, zenodo

SOURCE = SOURCES["thermalmix"]
ENTRY = {"key": "lion.zip", "size": 5, "checksum": "md5:" + "0" * 32, "links": {"self": "https://zenodo.org/x"}}


@pytest.fixture
def server():
    with zenodo({"lion.zip": b"12345", "a b.txt": b""}) as one:
        yield one


def test_files_of_a_record(server):
    address = f"{server.address}/api/records/1/files/"
    assert list_files(SOURCE, server.address + "/")[0] == [
        RemoteFile(PurePosixPath(name), f"{address}{name}/content", size, f"md5:{md5}")
        for name, size, md5 in (
            ("lion.zip", 5, "827ccb0eea8a706c4c34a16891f84e7b"),
            ("a b.txt", 0, "d41d8cd98f00b204e9800998ecf8427e"),
        )
    ]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"key": "../lion.zip"}, "'../lion.zip' leads out of its folder"),
        ({"key": 1}, r"files\.0\.key"),
        ({"size": -1}, r"files\.0\.size"),
        ({"checksum": "sha256:0"}, r"files\.0\.checksum"),
        ({"links": {}}, "'self'"),
    ],
)
def test_entries_that_are_not_zenodos(server, change, message):
    server.listing = json.dumps({"files": [ENTRY | change]}).encode()
    with pytest.raises(GetError, match=f"the files of ThermalMix cannot be listed: .*{message}"):
        list_files(SOURCE, server.address)


@pytest.mark.parametrize(
    ("answer", "message"), [(b"<html>", "Invalid JSON"), (b"{}", "files"), (b"[" * 100_000, "recursion")]
)
def test_answers_that_are_no_list(server, answer, message):
    server.listing = answer
    with pytest.raises(GetError, match=f"cannot be listed: .*{message}"):
        list_files(SOURCE, server.address)
    server.faults[""] = [Fault(status=410)]
    with pytest.raises(GetError, match="cannot be listed: 410 Client Error: Gone"):
        list_files(SOURCE, server.address)

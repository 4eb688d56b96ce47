import json

import pytest

from tdgbench.data.get.errors import GetError
from tdgbench.data.get.http import Patience
from tdgbench.data.get.sources import SOURCES
from tdgbench.data.get.zenodo import list_record
from tests.helpers.zenodo import Fault, zenodo

SOURCE = SOURCES["thermalmix"]
QUICK = Patience(attempts=3, first_seconds=0.01, connect_seconds=5.0, read_seconds=5.0)
ENTRY = {"key": "lion.zip", "size": 5, "checksum": "md5:" + "0" * 32, "links": {"self": "https://zenodo.org/x"}}


@pytest.fixture
def server():
    with zenodo({"lion.zip": b"12345", "a b.txt": b""}) as one:
        yield one


def test_files_of_a_record(server):
    lion, text = list_record(SOURCE, server.address + "/", QUICK)
    assert (str(lion.path), lion.size, lion.identity) == ("lion.zip", 5, "md5:827ccb0eea8a706c4c34a16891f84e7b")
    assert lion.address == f"{server.address}/api/records/1/files/lion.zip/content"
    assert (str(text.path), text.size) == ("a b.txt", 0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"key": "../lion.zip"}, "'../lion.zip' leads out of its folder"),
        ({"key": "a/lion.zip"}, "'a/lion.zip' is no name"),
        ({"key": ""}, "'' is no name"),
        ({"key": 1}, "the file name 1 is no text"),
        ({"size": -1}, "has the size -1"),
        ({"size": "5"}, "has the size '5'"),
        ({"size": True}, "has the size True"),
        ({"checksum": "sha256:0"}, "has the checksum 'sha256:0'"),
        ({"checksum": None}, "TypeError"),
        ({"links": {"self": "file:///etc/passwd"}}, "has the address 'file:///etc/passwd'"),
        ({"links": {}}, "KeyError: 'self'"),
    ],
)
def test_entries_that_are_not_zenodos(server, change, message):
    server.listing = json.dumps({"files": [ENTRY | change]}).encode()
    with pytest.raises(GetError, match=message) as error:
        list_record(SOURCE, server.address, QUICK)
    assert "open https://zenodo.org/records/11065834 in a browser" in str(error.value)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (b"<html>maintenance</html>", "is not what Zenodo's API gives"),
        (b"{}", "KeyError: 'files'"),
        (b"[]", "TypeError"),
        (b"\xff", "UnicodeDecodeError"),
        (b"[" * 100_000, "RecursionError"),
        (b'{"files": []}', "shows no file to the public; open https://zenodo.org/records/11065834"),
        (json.dumps({"files": [ENTRY, ENTRY | {"key": "Lion.zip"}]}).encode(), "has two files of the name Lion.zip"),
        (bytes(2**24 + 1), "answers with more than 16777216 bytes"),
    ],
)
def test_answers_that_are_no_list(server, answer, message):
    server.listing = answer
    with pytest.raises(GetError, match=message):
        list_record(SOURCE, server.address, QUICK)


def test_the_list_is_asked_for_again(server):
    server.faults[""] = [Fault(status=503), Fault(cut=10)]
    assert len(list_record(SOURCE, server.address, QUICK)) == 2 and server.listings == 3


def test_a_record_that_is_gone(server):
    server.faults[""] = [Fault(status=410)]
    with pytest.raises(GetError, match="the server answers 410 Gone"):
        list_record(SOURCE, server.address, QUICK)


def test_without_a_network():
    with pytest.raises(
        GetError, match=r"the name of the server has no address here \(is there a network\?\) \(3 times"
    ):
        list_record(SOURCE, patience=QUICK)


def test_a_server_that_is_not_there():
    with pytest.raises(GetError, match="cannot be fetched: Connection refused"):
        list_record(SOURCE, "http://127.0.0.1:9", QUICK)


@pytest.mark.parametrize("address", ["zenodo", "ftp://127.0.0.1", "http://"])
def test_no_address(address):
    with pytest.raises(GetError, match="cannot be fetched"):
        list_record(SOURCE, address, QUICK)

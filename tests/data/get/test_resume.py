"""One file; whole data sets, and the faults of servers, are in test_fetch.py."""

import hashlib
from pathlib import PurePosixPath

import pytest

from tdgbench.data.get import resume
from tdgbench.data.get.http import Patience
from tdgbench.data.get.remote import RemoteFile
from tdgbench.data.get.resume import download
from tests.helpers.zenodo import Fault, zenodo

CONTENT = bytes(range(256)) * 1000
QUICK = Patience(attempts=3, first_seconds=0.01)


@pytest.fixture
def server():
    with zenodo({"lion.zip": CONTENT, "empty.txt": b""}) as one:
        yield one


def remote(server, name: str) -> RemoteFile:
    content = server.files[name]
    address = f"{server.address}/api/records/1/files/{name}/content"
    return RemoteFile(PurePosixPath(name), address, len(content), f"md5:{hashlib.md5(content).hexdigest()}")


@pytest.mark.parametrize("name", ["lion.zip", "empty.txt"])
def test_a_file(tmp_path, server, name):
    reported = []
    for _ in range(2):
        download(remote(server, name), tmp_path / name, QUICK, reported.append)
    assert (tmp_path / name).read_bytes() == server.files[name] and [p.name for p in tmp_path.iterdir()] == [name]
    assert reported[-1] == len(server.files[name]) and len(server.requests) == (name != "empty.txt")


def test_a_file_system_without_links(tmp_path, server, monkeypatch):
    def refuse(*paths):
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(resume.os, "link", refuse)
    server.faults["lion.zip"] = [Fault(cut=100_000)]
    download(remote(server, "lion.zip"), tmp_path / "lion.zip", QUICK, lambda count: None)
    assert (tmp_path / "lion.zip").read_bytes() == CONTENT and len(list(tmp_path.iterdir())) == 1


def test_an_interruption_while_the_sum_is_computed_loses_nothing(tmp_path, server, monkeypatch):
    def interrupt(*arguments, **keywords):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("pooch.core.hash_matches", interrupt)
        with pytest.raises(KeyboardInterrupt):
            download(remote(server, "lion.zip"), tmp_path / "lion.zip", QUICK, lambda count: None)
    assert [p.name for p in tmp_path.iterdir()] == ["lion.zip.part"]
    download(remote(server, "lion.zip"), tmp_path / "lion.zip", QUICK, lambda count: None)
    assert (tmp_path / "lion.zip").read_bytes() == CONTENT and len(server.requests) == 1

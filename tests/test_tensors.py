"""Files of torch.save are read as data: no code, no more memory than the file has bytes."""

from __future__ import annotations

import os
import pickle
import re
import zipfile
from collections import OrderedDict
from pathlib import Path

import pytest
import torch

from tdgbench.tensors import load_tensors
from tests.helpers.memory import peak_mb


def saved(path: Path, content: object, **how) -> Path:
    torch.save(content, path, **how)
    return path


def test_tensors_and_plain_values_come_back(tmp_path):
    content = {"a": torch.arange(6.0).reshape(2, 3), "b": [1, 2.5, None, True, ("x", OrderedDict(c=torch.ones(2)))],
               3: torch.zeros(0), "part": torch.arange(10)[2:4]}  # fmt: skip
    path = saved(tmp_path / "a.pt", content)
    for mapped in (False, True):
        found = load_tensors(path, mapped=mapped)
        assert found["a"].tolist() == content["a"].tolist() and found["b"][4][1]["c"].tolist() == [1.0, 1.0]
        assert found["part"].tolist() == [2, 3] and found["b"][:4] == [1, 2.5, None, True]


class Calls:
    """What unpickles as a call."""

    def __init__(self, function, *arguments) -> None:
        self._call = function, arguments

    def __reduce__(self):
        return self._call


@pytest.mark.parametrize(
    ("function", "arguments", "name"),
    [(os.system, ("touch here",), "posix.system"), (bytearray, (10**10,), "__builtin__.bytearray"),
     (torch.zeros, (10**10,), "__builtin__.getattr")],
)  # fmt: skip
def test_nothing_is_called(tmp_path, function, arguments, name):
    path = saved(tmp_path / "a.pt", {"a": Calls(function, *arguments)})
    with pytest.raises(ValueError, match=rf"it names {re.escape(name)}, which is neither a tensor nor a plain value"):
        load_tensors(path)
    path.write_bytes(pickle.dumps(Calls(function, *arguments)))
    with pytest.raises(ValueError, match=r"it is no file of torch\.save"):
        load_tensors(path)
    assert not Path("here").exists()


def test_torchs_advice_to_trust_a_file_is_not_passed_on(tmp_path):
    path = saved(tmp_path / "a.pt", {"a": 1}, pickle_protocol=4)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    members["a/data.pkl"] = b"\x80\x02c__main__\nNothing\n)R."
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with pytest.raises(ValueError, match="it names") as caught:
        load_tensors(path)
    assert "weights_only" not in str(caught.value)


def test_compressed_members_are_refused(tmp_path):
    """A megabyte of zeros is a kilobyte."""
    path = saved(tmp_path / "a.pt", {"a": torch.zeros(2**20)})
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    with pytest.raises(ValueError, match="it is compressed"):
        load_tensors(path)


@pytest.mark.parametrize(
    "content",
    [torch.zeros(1).expand(10**12), [torch.zeros(1000).expand(10**6, 1000)] * 3, torch.eye(3).to_sparse(),
     {"a": {"b": torch.zeros(1).expand(10**12)}}],
)  # fmt: skip
def test_tensors_have_no_more_values_than_the_file(tmp_path, content):
    path = saved(tmp_path / "a.pt", content)

    def refused() -> None:
        with pytest.raises(ValueError, match=r"its tensors have|names torch\._utils"):
            load_tensors(path)

    assert peak_mb(refused) < 100


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo.pt")
    with pytest.raises(ValueError, match="it is a FIFO"):
        load_tensors(tmp_path / "fifo.pt")
    with pytest.raises(FileNotFoundError):
        load_tensors(tmp_path / "none.pt")
    (tmp_path / "cell").mkdir()
    saved(tmp_path / "a.pt", {})
    (tmp_path / "cell" / "a.pt").symlink_to(tmp_path / "a.pt")
    with pytest.raises(ValueError, match="it leads out of its folder"):
        load_tensors(tmp_path / "cell" / "a.pt", inside=tmp_path / "cell")
    for content in (b"", b"PK", (tmp_path / "a.pt").read_bytes()[:-9]):
        (tmp_path / "cut.pt").write_bytes(content)
        with pytest.raises(ValueError, match=r"it is no file of torch\.save"):
            load_tensors(tmp_path / "cut.pt")

"""Zip files of others: what is damaged, lies or is too much is refused before it takes memory or disk."""

from __future__ import annotations

import stat
import struct
import zipfile
import zlib
from contextlib import suppress
from pathlib import Path

import pytest

from tdgbench import archives
from tdgbench.archives import opened_zip, safe_path
from tests.helpers.archives import zipped
from tests.helpers.memory import peak_mb

FILES = {"lion/0.jpg": bytes(range(100)), "lion/é.txt": b"1", "lion/empty/": b""}
METHODS = {"stored": zipfile.ZIP_STORED, "deflated": zipfile.ZIP_DEFLATED}
DIRECTORY, END = b"PK\x01\x02", b"PK\x05\x06"


def read(path: Path, content: bytes) -> dict[str, bytes]:
    """Contents of the members of a zip file by name."""
    path.write_bytes(content)
    with opened_zip(path) as members:
        return {name: b"".join(member.chunks()) for name, member in members.items()}


def with_field(content: bytes, at: int, kind: str, value: int) -> bytes:
    return content[:at] + struct.pack(kind, value) + content[at + struct.calcsize(kind) :]


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_what_ends_early_or_has_a_changed_bit(tmp_path, method):
    """Wherever it is, no other content is read."""
    content = zipped(FILES, method)
    assert read(tmp_path / "a", content) == FILES
    for at in range(0, len(content), 3):
        with pytest.raises(ValueError):
            read(tmp_path / "a", content[:at])
        with suppress(ValueError):  # a time may have changed, or the length of a comment, which hides what follows
            assert read(tmp_path / "a", with_field(content, at, "B", content[at] ^ 0x10)).items() <= FILES.items()
    with pytest.raises(ValueError, match="it is damaged"):
        read(tmp_path / "a", with_field(content, 80, "B", content[80] ^ 0x10))


@pytest.mark.parametrize("content", [b"", b"<html>", b"PK\x03\x04", END + bytes(17)])
def test_what_is_no_zip_file(tmp_path, content):
    with pytest.raises(ValueError, match="it is damaged: "):
        read(tmp_path / "a", content)


def test_members_that_lie_elsewhere(tmp_path):
    """Before the beginning of the file, and on the bytes of another member, as in zip bombs of high density."""
    content = zipped({"lion/1": b"1" * 100, "lion/2": b"2" * 100})
    second, start = content.rindex(DIRECTORY), content.index(END) + 16  # where the directory says that it lies
    with pytest.raises(ValueError):
        read(tmp_path / "a", with_field(content, start, "<I", struct.unpack_from("<I", content, start)[0] + 2**20))
    with pytest.raises(ValueError, match="it is damaged"):
        read(tmp_path / "a", with_field(content, second + 42, "<I", 0))


MODES = {"link": stat.S_IFLNK, "FIFO": stat.S_IFIFO, "device": stat.S_IFCHR, "folder": stat.S_IFDIR}


@pytest.mark.parametrize("mode", MODES.values(), ids=MODES)
def test_members_that_are_no_files(tmp_path, mode):
    info = zipfile.ZipInfo("lion/link")
    info.create_system, info.external_attr = 3, (mode | 0o777) << 16
    with zipfile.ZipFile(tmp_path / "a", "w") as archive:
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(ValueError, match="'lion/link' is no regular file"), opened_zip(tmp_path / "a"):
        pass


def test_members_that_are_encrypted_or_compressed_otherwise(tmp_path):
    content = zipped({"a": b"1"})
    with pytest.raises(ValueError, match="'a' is encrypted"):
        read(tmp_path / "a", with_field(content, content.index(DIRECTORY) + 8, "<H", 1))
    for method in (zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA):
        with pytest.raises(ValueError, match="'a' is compressed in another way than by deflate"):
            read(tmp_path / "a", zipped({"a": b"1"}, method))


def test_names(tmp_path):
    """One without the flag of UTF-8 is UTF-8 all the same, or refused."""
    plain = zipped({"lion/123.jpg": b"1"})
    assert read(tmp_path / "a", plain.replace(b"123", "é1".encode())) == {"lion/é1.jpg": b"1"}
    with pytest.raises(ValueError, match="'utf-8' codec"):
        read(tmp_path / "a", plain.replace(b"123", "é12".encode("latin-1")))


@pytest.mark.parametrize("name", ["../a", "b/../../a", "/etc/a", "C:/a", "b\\..\\a", "b/a\x1b[2J", "b\na"])
def test_names_that_lead_elsewhere(name):
    with pytest.raises(ValueError, match=r"leads out of its folder|cannot be printed"):
        safe_path(name)


def test_more_than_a_hundred_times_the_bytes(tmp_path, monkeypatch):
    content = zipped({"a": bytes(2**20), "b": bytes(2**20)}, zipfile.ZIP_DEFLATED)
    assert len(read(tmp_path / "a", content)) == 2  # little, whatever the ratio
    monkeypatch.setattr(archives, "HARMLESS", 2**20)
    with pytest.raises(ValueError, match="it would unpack to 2 MB, more than 1 MB"):
        read(tmp_path / "a", content)


def test_many_members(tmp_path, monkeypatch):
    """Their list is refused by the size that zipfile would read, whichever of the two records states it."""
    content = zipped(FILES)
    end = content.rindex(END)
    count, _, size, start = struct.unpack_from("<HHII", content, end + 8)
    wide = struct.pack("<4sQHHIIQQQQ", b"PK\x06\x06", 44, 45, 45, 0, 0, count, count, size, start)
    wide = content[:end] + wide + struct.pack("<4sIQI", b"PK\x06\x07", 0, end, 1) + content[end:]
    lying = with_field(wide, wide.rindex(END) + 12, "<I", 0)
    assert read(tmp_path / "a", lying) == FILES
    monkeypatch.setattr(archives, "MOST_LIST", size - 1)
    for one in (content, wide, lying):
        with pytest.raises(ValueError, match=r"its list of files has 1.. bytes, more than"):
            read(tmp_path / "a", one)
    monkeypatch.undo()
    monkeypatch.setattr(archives, "MOST_MEMBERS", len(FILES) - 1)
    with pytest.raises(ValueError, match="it holds 3 files, more than 2"):
        read(tmp_path / "a", content)


def test_a_size_that_lies(tmp_path):
    """A member that declares 1 kB and holds 100 MB: no more than declared is given, and little is in memory."""
    with zipfile.ZipFile(tmp_path / "a", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a", "w") as member:
        for _ in range(100):
            member.write(bytes(10**6))
    content = (tmp_path / "a").read_bytes()
    content = with_field(content, content.rindex(DIRECTORY) + 24, "<I", 1000)
    content = with_field(content, content.rindex(DIRECTORY) + 16, "<I", zlib.crc32(bytes(1000)))
    found = {}
    assert peak_mb(lambda: found.update(read(tmp_path / "a", content))) < 50
    assert found == {"a": bytes(1000)}

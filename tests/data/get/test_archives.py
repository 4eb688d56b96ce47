"""Archives are read; what is damaged, or would write elsewhere or too much, is refused."""

from __future__ import annotations

import bz2
import gzip
import io
import resource
import stat
import tarfile
import tempfile
import zipfile
import zlib
from functools import partial
from pathlib import Path

import pytest

from tdgbench.data.get import archives
from tdgbench.data.get.archives import unpack
from tdgbench.data.get.sources import BadFileError
from tests.helpers.archives import scene_files, tarred, zipped

NAMES = {
    "../evil": "leads out of its folder",
    "lion/../../evil": "leads out of its folder",
    "/etc/evil": "leads out of its folder",
    "C:/evil": "leads out of its folder",
    "lion\\..\\..\\evil": "leads out of its folder",
    "lion/a\x1b[2Jb": "has characters that cannot be printed",
    "lion/a\nb": "has characters that cannot be printed",
}
FILES = scene_files("lion")


def unpacked(path: Path, content: bytes) -> dict[str, bytes]:
    """Contents of the files of an archive by their paths."""
    path.write_bytes(content)
    folder = Path(tempfile.mkdtemp(dir=path.parent))
    return {str(file): (folder / file).read_bytes() for file in unpack(path, folder)}


KINDS = {
    **{f"tar.{name}" if name else "tar": partial(tarred, compression=name) for name in ("", "gz", "bz2", "xz")},
    "zip": zipped,
    "zip, deflated": partial(zipped, compression=zipfile.ZIP_DEFLATED),
    "zip, bzip2": partial(zipped, compression=zipfile.ZIP_BZIP2),
    "zip, LZMA": partial(zipped, compression=zipfile.ZIP_LZMA),
}
WITH_SUMS = [kind for kind in KINDS if kind != "tar"]


@pytest.mark.parametrize("kind", KINDS)
def test_archives_of_all_kinds(tmp_path, kind):
    assert unpacked(tmp_path / "a", KINDS[kind](FILES)) == FILES


def test_folders(tmp_path):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        info = tarfile.TarInfo("lion")
        info.type = tarfile.DIRTYPE
        archive.addfile(info)
    assert unpacked(tmp_path / "a.tar", out.getvalue()) == unpacked(tmp_path / "a.zip", zipped({"lion/": b""})) == {}


@pytest.mark.parametrize("where", [0.0001, 0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize("kind", KINDS)
def test_archives_that_end_early(tmp_path, kind, where):
    content = KINDS[kind](FILES)
    end = int(where * len(content)) if kind != "tar" else int(where * content.rindex(b"ustar"))  # zeros follow
    with pytest.raises(BadFileError, match=r"a cannot be unpacked: .*; --force downloads it again"):
        unpacked(tmp_path / "a", content[:end])


@pytest.mark.parametrize("where", [0.001, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("kind", WITH_SUMS)
def test_a_changed_byte_is_found(tmp_path, kind, where):
    """By the sums inside the archives, where nobody publishes one."""
    content = bytearray(KINDS[kind](FILES))
    content[int(where * len(content))] ^= 1
    with pytest.raises(BadFileError, match=r"a (cannot be unpacked|is refused)"):
        unpacked(tmp_path / "a", bytes(content))


@pytest.mark.parametrize("pack", [lambda raw: raw, gzip.compress, bz2.compress])
@pytest.mark.parametrize("change", [lambda raw, at: raw[:at], lambda raw, at: raw[:at] + b"?" + raw[at + 1 :]])
def test_a_tar_file_that_ends_between_members(tmp_path, pack, change):
    """Its members so far are whole, and tarfile takes what follows for the end."""
    raw = tarred(FILES, "")
    last = raw.rindex(b"ustar") - 257  # where the header of the last member begins
    with pytest.raises(BadFileError, match="a cannot be unpacked: it ends early, or the header of a member is damaged"):
        unpacked(tmp_path / "a", pack(change(raw, last)))


def test_a_member_before_the_beginning(tmp_path):
    content = bytearray(zipped({"a": b"1", "b": b"2"}))
    end = content.index(b"PK\x05\x06") + 16  # where the directory says that it lies; members are counted from there
    content[end : end + 4] = (int.from_bytes(content[end : end + 4], "little") + 2**20).to_bytes(4, "little")
    with pytest.raises(BadFileError, match="a cannot be unpacked"):
        unpacked(tmp_path / "a", bytes(content))


@pytest.mark.parametrize("content", [b"", b"<html>", b"PK\x03\x04", b"\x1f\x8b\x08\x00", b"BZh91AY"])
def test_what_is_no_archive(tmp_path, content):
    with pytest.raises(BadFileError, match=r"a\.zip cannot be unpacked"):
        unpacked(tmp_path / "a.zip", content)


@pytest.mark.parametrize("pack", [zipped, tarred], ids=["zip", "tar"])
@pytest.mark.parametrize("name", NAMES)
def test_names(tmp_path, pack, name):
    with pytest.raises(BadFileError, match=NAMES[name]) as refused:
        unpacked(tmp_path / "a.bin", pack({"lion/1.jpg": b"1", name: b"2"}))
    assert "a.bin is refused" in str(refused.value) and "nothing of it is in place" in str(refused.value)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (tarfile.SYMTYPE, "a link"),
        (tarfile.LNKTYPE, "a link"),
        (tarfile.CHRTYPE, "a special file"),
        (tarfile.BLKTYPE, "a special file"),
        (tarfile.FIFOTYPE, "a special file"),
        (tarfile.CONTTYPE, None),  # by POSIX a file like any other
        (b"Z", "a special file"),
    ],
)
def test_members_of_tar_files_that_are_no_files(tmp_path, kind, said):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        info = tarfile.TarInfo("lion/link")
        info.type, info.linkname = kind, "/etc/passwd"
        archive.addfile(info)
    if said is None:
        assert unpacked(tmp_path / "a.tar", out.getvalue()) == {"lion/link": b""}
    else:
        with pytest.raises(BadFileError, match=f"'lion/link' is {said}"):
            unpacked(tmp_path / "a.tar", out.getvalue())


@pytest.mark.parametrize(
    ("mode", "said"), [(stat.S_IFLNK, "a link"), (stat.S_IFIFO, "a special file"), (stat.S_IFCHR, "a special")]
)
def test_members_of_zip_files_that_are_no_files(tmp_path, mode, said):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        info = zipfile.ZipInfo("lion/link")
        info.create_system, info.external_attr = 3, (mode | 0o777) << 16
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(BadFileError, match=f"'lion/link' is {said}"):
        unpacked(tmp_path / "a.zip", out.getvalue())


def test_encrypted_members(tmp_path):
    content = bytearray(zipped({"lion/1.jpg": b"1"}))
    content[6] |= 1  # flags of the local header
    content[content.index(b"PK\x01\x02") + 8] |= 1  # and of the central directory
    with pytest.raises(BadFileError, match=r"'lion/1\.jpg' is encrypted"):
        unpacked(tmp_path / "a.zip", bytes(content))


def test_names_in_other_encodings(tmp_path):
    """A zip name without the flag of UTF-8 is UTF-8 all the same, or refused; so is one of a tar file."""

    def renamed(content: bytes, name: bytes) -> bytes:
        return content.replace(b"lion/123456.jpg", name)

    plain = zipped({"lion/123456.jpg": b"1"})
    assert unpacked(tmp_path / "a.zip", renamed(plain, "lion/é1234.jpg".encode())) == {"lion/é1234.jpg": b"1"}
    with pytest.raises(BadFileError, match="cannot be unpacked: 'utf-8' codec"):
        unpacked(tmp_path / "b.zip", renamed(plain, "lion/é12345.jpg".encode("latin-1")))
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", encoding="latin-1", format=tarfile.GNU_FORMAT) as archive:
        archive.addfile(tarfile.TarInfo("lion/é.jpg"))
    with pytest.raises(BadFileError, match="cannot be printed"):
        unpacked(tmp_path / "a.tar", out.getvalue())


@pytest.mark.parametrize("compression", ["gz", "bz2", "xz", None], ids=["tar.gz", "tar.bz2", "tar.xz", "zip"])
def test_bombs(tmp_path, monkeypatch, compression):
    """70 MB of zeros in some kB. The refusal comes at the declared size, before the zeros are unpacked."""
    zeros = {"lion/rgb/1.npy": bytes(2**20), "lion/rgb/2.npy": bytes(2**20)}
    content = tarred(zeros, compression) if compression else zipped(zeros, zipfile.ZIP_DEFLATED)
    assert len(unpacked(tmp_path / "a.bin", content)) == 2  # harmless: small, whatever the ratio
    monkeypatch.setattr(archives, "HARMLESS", 10**6)
    with pytest.raises(BadFileError, match=r"of \d+\.?\d* ?(kB|bytes), it would unpack to more than 1.0 MB"):
        unpacked(tmp_path / "a.bin", content)


def test_a_member_that_points_to_the_bytes_of_another(tmp_path):
    """As in zip bombs of high density, whose members share their bytes."""
    content = zipped({"lion/1": b"1" * 100, "lion/2": b"2" * 100})
    second = content.rindex(b"PK\x01\x02")
    overlapping = content[: second + 42] + content[content.index(b"PK\x01\x02") + 42 :][:4] + content[second + 46 :]
    with pytest.raises(BadFileError, match="cannot be unpacked"):
        unpacked(tmp_path / "a.zip", overlapping)


def test_what_file_managers_leave_is_left_out(tmp_path):
    names = ("__MACOSX/lion/._1.jpg", "lion/.DS_Store", "lion/Thumbs.db", "lion/.download.json", "./lion/1.jpg")
    assert unpacked(tmp_path / "a.tar", tarred(dict.fromkeys(names, b"1"))) == {"lion/1.jpg": b"1"}


def test_too_many_members(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "MOST_MEMBERS", len(FILES))
    for kind, pack in KINDS.items():
        assert len(unpacked(tmp_path / kind, pack(FILES))) == len(FILES)
        with pytest.raises(BadFileError, match=r"is refused: it has more than \d+ members; nothing of it is in place"):
            unpacked(tmp_path / kind, pack({**FILES, ".hidden": b""}))


def declared(kind: bytes, size: int, name: str = "a") -> bytes:
    """A header of a tar file that states a size."""
    info = tarfile.TarInfo(name)
    info.type = kind
    header = bytearray(info.tobuf(tarfile.GNU_FORMAT))
    header[124:136], header[148:156] = tarfile.itn(size, 12, tarfile.GNU_FORMAT), b" " * 8
    header[148:156] = b"%06o\0 " % sum(header)
    return bytes(header)


HEADERS = {
    "a negative file": ((tarfile.REGTYPE, -512), "'a' is of negative size"),
    "a negative file of no kind": ((b"Z", -1024), "'a' is of negative size"),
    "negative details": ((tarfile.XHDTYPE, -512), "cannot be unpacked"),
    "large details": ((tarfile.XHDTYPE, 10**8), "states a size of more than 65.5 kB"),
    "a long name": ((tarfile.GNUTYPE_LONGNAME, 10**8), "states a size of more than 65.5 kB"),
    "nothing, and much behind the end": ((tarfile.REGTYPE, 0), r"it has more than \d+\.\d MB, headers included"),
}


@pytest.mark.parametrize(("header", "said"), HEADERS.values(), ids=HEADERS)
def test_sizes_that_lie_in_tar_files(tmp_path, header, said):
    """200 MB in 1 MB, which no member declares."""
    content = gzip.compress(declared(*header) + bytes(2 * 10**8), 1)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BadFileError, match=said):
        unpacked(tmp_path / "a", content)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # KB


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2])
def test_sizes_that_lie_in_zip_files(tmp_path, method):
    """Members that declare 1 kB and hold 300 MB: no more than declared is written, and little is in memory."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive, archive.open("a", "w") as member:
        for _ in range(300):
            member.write(bytes(10**6))
    content = bytearray(out.getvalue())
    entry = content.rindex(b"PK\x01\x02")
    content[entry + 16 : entry + 20] = zlib.crc32(bytes(1000)).to_bytes(4, "little")
    content[entry + 24 : entry + 28] = (1000).to_bytes(4, "little")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert unpacked(tmp_path / "a", bytes(content)) == {"a": bytes(1000)}
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 150_000  # KB


def test_a_list_of_members_that_is_too_long(tmp_path, monkeypatch):
    monkeypatch.setattr(archives, "LARGEST_INDEX", 200)
    with pytest.raises(BadFileError, match="states a size of more than 200 bytes"):
        unpacked(tmp_path / "a", zipped(FILES))


def test_a_name_that_is_too_long(tmp_path):
    with pytest.raises(BadFileError, match=r"cannot be unpacked: .*too long"):
        unpacked(tmp_path / "a", zipped({"x" * 300: b""}))

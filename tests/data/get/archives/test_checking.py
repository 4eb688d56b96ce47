"""Archives that would write elsewhere, or too much, are refused before anything is unpacked."""

from __future__ import annotations

import io
import stat
import tarfile
import zipfile
from pathlib import Path

import pytest

from tdgbench.data.get.archives.checking import Limits, checked_files
from tdgbench.data.get.archives.reading import opened, readable
from tdgbench.data.get.errors import BadFileError
from tests.helpers.archives import tarred, zipped

NAMES = {
    "../evil": "leads out of its folder",
    "lion/../../evil": "leads out of its folder",
    "/etc/evil": "is an absolute path",
    "C:/evil": "is an absolute path",
    "lion\\..\\..\\evil": "has a backslash",
    "lion/a\x1b[2Jb": "has characters that cannot be printed",
    "lion/a\nb": "has characters that cannot be printed",
    f"lion/{'n' * 256}": "is longer than 255 bytes",
}
CLASHES = (
    ("lion/1.jpg", "lion/1.JPG"),
    ("lion/\u00e9.jpg", "lion/e\u0301.jpg"),
    ("lion/rgb", "lion/rgb/1.jpg"),
    ("LION/RGB/1.jpg", "lion/rgb"),
    ("lion/1.jpg", "./lion//1.jpg"),
)


def files_of(path: Path, content: bytes, limits: Limits | None = None) -> list[str]:
    """Paths of the files to unpack."""
    path.write_bytes(content)
    with opened(path) as archive:
        return [str(file.path) for file in checked_files(archive, path, *([limits] if limits else []))]


@pytest.mark.parametrize("pack", [zipped, tarred], ids=["zip", "tar"])
@pytest.mark.parametrize("name", NAMES)
def test_names(tmp_path, pack, name):
    with pytest.raises(BadFileError, match=NAMES[name]) as refused:
        files_of(tmp_path / "a.bin", pack({"lion/1.jpg": b"1", name: b"2"}))
    assert "a.bin is refused" in str(refused.value) and "nothing of it was unpacked" in str(refused.value)


@pytest.mark.parametrize("pack", [zipped, tarred], ids=["zip", "tar"])
@pytest.mark.parametrize("names", CLASHES)
def test_names_that_a_file_system_may_confuse(tmp_path, pack, names):
    with pytest.raises(BadFileError, match="two members that a file system may take for one"):
        files_of(tmp_path / "a.bin", pack(dict.fromkeys(names, b"1")))


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_equal_names(tmp_path):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for content in ("one", "two"):
            archive.writestr("lion/1.jpg", content)
    with pytest.raises(BadFileError, match=r"may take for one: 'lion/1.jpg'"):
        files_of(tmp_path / "a.zip", out.getvalue())


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (tarfile.SYMTYPE, "a symbolic link"),
        (tarfile.LNKTYPE, "a hard link"),
        (tarfile.CHRTYPE, "a device"),
        (tarfile.BLKTYPE, "a device"),
        (tarfile.FIFOTYPE, "a FIFO"),
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
        assert files_of(tmp_path / "a.tar", out.getvalue()) == ["lion/link"]
    else:
        with pytest.raises(BadFileError, match=f"'lion/link' is {said}"):
            files_of(tmp_path / "a.tar", out.getvalue())


@pytest.mark.parametrize(
    ("mode", "said"), [(stat.S_IFLNK, "a symbolic link"), (stat.S_IFIFO, "a special file"), (stat.S_IFCHR, "a special")]
)
def test_members_of_zip_files_that_are_no_files(tmp_path, mode, said):
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        info = zipfile.ZipInfo("lion/link")
        info.create_system, info.external_attr = 3, (mode | 0o777) << 16
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(BadFileError, match=f"'lion/link' is {said}"):
        files_of(tmp_path / "a.zip", out.getvalue())


def test_encrypted_members(tmp_path):
    content = bytearray(zipped({"lion/1.jpg": b"1"}))
    content[6] |= 1  # flags of the local header
    content[content.index(b"PK\x01\x02") + 8] |= 1  # and of the central directory
    with pytest.raises(BadFileError, match=r"'lion/1\.jpg' is encrypted"):
        files_of(tmp_path / "a.zip", bytes(content))


def test_names_in_other_encodings(tmp_path):
    """A zip name without the flag of UTF-8 is UTF-8 all the same, or refused; so is one of a tar file."""

    def renamed(content: bytes, name: bytes) -> bytes:
        return content.replace(b"lion/123456.jpg", name)

    plain = zipped({"lion/123456.jpg": b"1"})
    assert files_of(tmp_path / "a.zip", renamed(plain, "lion/é1234.jpg".encode())) == ["lion/é1234.jpg"]
    with pytest.raises(BadFileError, match="a name of unknown encoding"):
        files_of(tmp_path / "b.zip", renamed(plain, "lion/é12345.jpg".encode("latin-1")))
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", encoding="latin-1", format=tarfile.GNU_FORMAT) as archive:
        archive.addfile(tarfile.TarInfo("lion/é.jpg"))
    with pytest.raises(BadFileError, match="is not UTF-8"):
        files_of(tmp_path / "a.tar", out.getvalue())


@pytest.mark.parametrize("compression", ["gz", "bz2", "xz", None], ids=["tar.gz", "tar.bz2", "tar.xz", "zip"])
def test_bombs(tmp_path, compression):
    """70 MB of zeros in some kB. The refusal comes at the declared size, before the zeros are unpacked."""
    zeros = {"lion/rgb/1.npy": bytes(2**20), "lion/rgb/2.npy": bytes(2**20)}
    content = tarred(zeros, compression) if compression else zipped(zeros, zipfile.ZIP_DEFLATED)
    with pytest.raises(BadFileError, match=r"of \d+\.?\d* ?(kB|bytes), it would unpack to more than 1.0 MB"):
        files_of(tmp_path / "a.bin", content, Limits(harmless=10**6, ratio=50))
    assert len(files_of(tmp_path / "a.bin", content)) == 2  # harmless: small, whatever the ratio


def test_a_bomb_of_many_members(tmp_path):
    content = zipped({f"lion/{n}": b"" for n in range(11)})
    with pytest.raises(BadFileError, match="it has more than 10 members"):
        files_of(tmp_path / "a.zip", content, Limits(files=10))


def test_a_member_that_points_to_the_bytes_of_another(tmp_path):
    """As in zip bombs of high density, whose members share their bytes."""
    content = zipped({"lion/1": b"1" * 100, "lion/2": b"2" * 100})
    second = content.rindex(b"PK\x01\x02")
    overlapping = content[: second + 42] + content[content.index(b"PK\x01\x02") + 42 :][:4] + content[second + 46 :]
    path = tmp_path / "a.zip"
    path.write_bytes(overlapping)
    with opened(path) as archive:
        _, shared = checked_files(archive, path)
        with pytest.raises(BadFileError, match="cannot be unpacked"), readable(path), archive.content(shared.member):
            pass


def test_a_header_that_claims_gigabytes(tmp_path):
    """A PAX header is read into memory as a whole, so its size is limited."""
    info = tarfile.TarInfo("header")
    info.type, info.size = tarfile.XHDTYPE, 2**30
    with pytest.raises(BadFileError, match="header of 1073741824 bytes"):
        files_of(tmp_path / "a.tar", info.tobuf() + bytes(2**16))


def test_what_file_managers_leave_is_left_out(tmp_path):
    names = ("__MACOSX/lion/._1.jpg", "lion/.DS_Store", "lion/Thumbs.db", "lion/.download.json", "./lion/1.jpg")
    assert files_of(tmp_path / "a.tar", tarred(dict.fromkeys(names, b"1"))) == ["lion/1.jpg"]

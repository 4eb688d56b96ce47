import gzip
import io
import tarfile

import pytest

from tdgbench.data.get.archives.reading import opened, readable
from tdgbench.data.get.errors import BadFileError
from tests.helpers.archives import scene_files, tarred, zipped

FILES = scene_files("lion")


def contents(path) -> dict[str, bytes]:
    with opened(path) as archive:
        return {
            member.name: archive.content(member).read() for member in list(archive.members()) if member.kind == "file"
        }


@pytest.mark.parametrize("compression", ["", "gz", "bz2", "xz"])
def test_tar_files(tmp_path, compression):
    (tmp_path / "a").write_bytes(tarred(FILES, compression))
    assert contents(tmp_path / "a") == FILES


def test_zip_files(tmp_path):
    (tmp_path / "a").write_bytes(zipped(FILES))
    assert contents(tmp_path / "a") == FILES


def test_folders(tmp_path):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w") as archive:
        info = tarfile.TarInfo("lion")
        info.type = tarfile.DIRTYPE
        archive.addfile(info)
    (tmp_path / "a.tar").write_bytes(out.getvalue())
    (tmp_path / "a.zip").write_bytes(zipped({"lion/": b""}))
    for name in ("a.tar", "a.zip"):
        with opened(tmp_path / name) as archive:
            assert [member.kind for member in archive.members()] == ["folder"]


@pytest.mark.parametrize("where", [0.1, 0.5, 0.9, 0.999])
@pytest.mark.parametrize(
    "pack", [zipped, tarred, lambda files: tarred(files, "xz"), lambda files: tarred(files, "bz2")]
)
def test_archives_that_end_early(tmp_path, pack, where):
    content = pack(FILES)
    (tmp_path / "a").write_bytes(content[: int(where * len(content))])
    with (
        pytest.raises(BadFileError, match=r"a cannot be unpacked: .*; --force downloads it again"),
        readable(tmp_path / "a"),
    ):
        contents(tmp_path / "a")


@pytest.mark.parametrize(
    "pack",
    [zipped, *(lambda files, c=c: tarred(files, c) for c in ("gz", "bz2", "xz"))],
    ids=["zip", "tar.gz", "tar.bz2", "tar.xz"],
)
def test_a_changed_byte_is_found(tmp_path, pack):
    """By the sums inside the archives, where nobody publishes one."""
    content = bytearray(pack(FILES))
    content[len(content) // 2] ^= 1
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(BadFileError, match="a cannot be unpacked"), readable(tmp_path / "a"):
        contents(tmp_path / "a")


def test_a_member_before_the_beginning(tmp_path):
    content = bytearray(zipped({"a": b"1", "b": b"2"}))
    end = content.index(b"PK\x05\x06") + 16  # where the directory says that it lies; members are counted from there
    content[end : end + 4] = (int.from_bytes(content[end : end + 4], "little") + 2**20).to_bytes(4, "little")
    (tmp_path / "a").write_bytes(content)
    with pytest.raises(BadFileError, match="a cannot be unpacked"), readable(tmp_path / "a"):
        contents(tmp_path / "a")


def test_much_after_the_last_member(tmp_path):
    tail = bytes(2**24)
    (tmp_path / "a").write_bytes(gzip.compress(tarred(FILES, "") + tail, 1))
    with pytest.raises(BadFileError, match="16777216 bytes or more follow"), readable(tmp_path / "a"):
        contents(tmp_path / "a")


@pytest.mark.parametrize("content", [b"", b"<html>", b"PK\x03\x04", b"\x1f\x8b\x08\x00", b"BZh91AY"])
def test_what_is_no_archive(tmp_path, content):
    (tmp_path / "a.zip").write_bytes(content)
    with pytest.raises(BadFileError, match=r"a\.zip cannot be unpacked"), readable(tmp_path / "a.zip"):
        contents(tmp_path / "a.zip")


def test_a_full_disk_is_no_damaged_archive(tmp_path):
    with pytest.raises(OSError, match="No space left"), readable(tmp_path):
        raise OSError(28, "No space left on device")

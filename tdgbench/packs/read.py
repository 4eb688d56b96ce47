"""Read a pack: names, sizes, hashes are checked before anything is used; nothing is written outside its folder."""

from __future__ import annotations

import hashlib
import shutil
import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tdgbench.files import MB, in_mb, opened, whole_folder
from tdgbench.packs import manifest
from tdgbench.packs.limits import MOST_MANIFEST, check_amount, check_directory, most_bytes
from tdgbench.packs.manifest import Manifest, read_manifest, sha256

CHUNK = MB  # bytes that are unpacked at once


@contextmanager
def opened_pack(path: Path) -> Iterator[Path]:
    """Yield the results folder of a pack, in a temporary folder; a folder is yielded as it is.

    Raises ValueError, naming the file, for what is no pack or was changed.
    """
    if not path.is_file():
        yield path
        return
    with unpacked(path) as (folder, *_):
        yield folder


@contextmanager
def unpacked(path: Path) -> Iterator[tuple[Path, Manifest, str]]:
    """Yield a pack's results in a temporary folder, its manifest and its hash; errors name the pack, not the folder."""
    with TemporaryDirectory(prefix="tdgbench-") as place:
        folder = Path(place) / "pack"
        folder.mkdir()
        content, digest = _extract(path, folder)
        folder = folder.rename(folder.with_name(content.experiment))
        try:
            yield folder, content, digest
        except (ValueError, OSError) as error:
            if str(folder) not in str(error):
                raise
            raise ValueError(str(error).replace(str(folder), str(path))) from error


def unpack(path: Path, folder: Path) -> tuple[Manifest, str]:
    """Unpack a pack into a new folder, whole or not at all; return its manifest and its hash.

    Raises ValueError, naming the file, for what is no pack, was changed or is too large, and FileExistsError if the
    folder is there.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} is there already; name a new folder")
    with whole_folder(folder) as part:
        return _extract(path, part)


def _extract(path: Path, folder: Path) -> tuple[Manifest, str]:
    """Unpack a pack into an empty folder; return its manifest and its hash. Raises as `unpack`."""
    try:
        with opened(path) as file:
            check_directory(file)
            with zipfile.ZipFile(file) as archive:
                return _extract_members(archive, file.seek(0, 2), folder)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path} does not exist") from error
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"{path} is no pack, or damaged: {error}") from error
    except ValueError as error:
        raise ValueError(f"{path} is no pack, or was changed: {error}") from error


def _extract_members(archive: zipfile.ZipFile, packed: int, folder: Path) -> tuple[Manifest, str]:
    """Unpack the members of an archive of `packed` bytes: what they state is checked before any of them is read."""
    members = {info.filename: info for info in archive.infolist()}
    if len(members) < len(archive.infolist()):
        raise ValueError("it holds two files of one name")
    check_amount(members, sum(info.file_size for info in members.values()), packed)
    if manifest.FILE not in members:
        raise ValueError(f"it has no {manifest.FILE}")
    text = b"".join(_chunks(archive, members.pop(manifest.FILE), MOST_MANIFEST))
    content = read_manifest(text)
    for name in sorted(set(members) ^ set(content.files)):
        raise ValueError(f"{name} is {'not in the manifest' if name in members else 'missing'}")
    for name, expected in content.files.items():
        if expected.size > most_bytes(name):
            raise ValueError(f"{name} has {in_mb(expected.size)}, more than {in_mb(most_bytes(name))}")
    free = shutil.disk_usage(folder).free
    if sum(file.size for file in content.files.values()) > free:
        raise ValueError(f"the disk has {in_mb(free)} left, which is less than it would unpack to")
    for name, expected in content.files.items():
        target, digest, size = folder / name, hashlib.sha256(), 0
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as out:
            for chunk in _chunks(archive, members[name], expected.size):
                size += out.write(chunk)
                digest.update(chunk)
        if size != expected.size or digest.hexdigest() != expected.sha256:
            raise ValueError(f"{name} is not what the manifest states")
    return content, sha256(text)


def _chunks(archive: zipfile.ZipFile, info: zipfile.ZipInfo, most: int) -> Iterator[bytes]:
    """Yield the content of a file of at most so many bytes, whatever size the archive states."""
    kind = stat.S_IFMT(info.external_attr >> 16)
    if info.is_dir() or kind not in (0, stat.S_IFREG):
        raise ValueError(f"{info.filename} is no regular file")
    if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError(f"{info.filename} is compressed in another way than by deflate")
    left = most
    with archive.open(info) as file:
        while chunk := file.read(min(CHUNK, left + 1)):
            left -= len(chunk)
            if left < 0:
                raise ValueError(f"{info.filename} is larger than {most} bytes")
            yield chunk

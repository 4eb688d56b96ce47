"""Read a pack: sizes and hashes are checked before anything is used, and nothing is written outside its folder."""

from __future__ import annotations

import stat
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tdgbench.files import whole_folder
from tdgbench.packs import manifest
from tdgbench.packs.manifest import Manifest, read_manifest, sha256


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
        content, digest = unpack(path, folder)
        folder = folder.rename(folder.with_name(content.experiment))
        try:
            yield folder, content, digest
        except (ValueError, OSError) as error:
            if str(folder) not in str(error):
                raise
            raise ValueError(str(error).replace(str(folder), str(path))) from error


def unpack(path: Path, folder: Path) -> tuple[Manifest, str]:
    """Unpack a pack into a new folder, whole or not at all; return its manifest and its hash.

    Raises ValueError, naming the file, for what is no pack or was changed, and FileExistsError if the folder is there.
    """
    if folder.exists():
        raise FileExistsError(f"{folder} is there already; name a new folder")
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist")
    try:
        with zipfile.ZipFile(path) as archive, whole_folder(folder) as part:
            return _extract(archive, part)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"{path} is no pack, or damaged: {error}") from error
    except ValueError as error:
        raise ValueError(f"{path} is no pack, or was changed: {error}") from error


def _extract(archive: zipfile.ZipFile, folder: Path) -> tuple[Manifest, str]:
    entries = {info.filename: info for info in archive.infolist()}
    if len(entries) < len(archive.infolist()):
        raise ValueError("it holds two files of one name")
    if manifest.FILE not in entries:
        raise ValueError(f"it has no {manifest.FILE}")
    text = _read(archive, entries.pop(manifest.FILE), manifest.MOST_BYTES)
    content = read_manifest(text)
    for name in sorted(set(entries) ^ set(content.files)):
        raise ValueError(f"{name} is {'not in the manifest' if name in entries else 'missing'}")
    for name, expected in content.files.items():
        stored = _read(archive, entries[name], expected.size)
        if len(stored) != expected.size or sha256(stored) != expected.sha256:
            raise ValueError(f"{name} is not what the manifest states")
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(stored)
    return content, sha256(text)


def _read(archive: zipfile.ZipFile, info: zipfile.ZipInfo, most: int) -> bytes:
    """Read a file of at most so many bytes, whatever size the archive states."""
    kind = stat.S_IFMT(info.external_attr >> 16)
    if info.is_dir() or kind not in (0, stat.S_IFREG):
        raise ValueError(f"{info.filename} is no regular file")
    with archive.open(info) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise ValueError(f"{info.filename} is larger than {most} bytes")
    return content

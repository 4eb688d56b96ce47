"""Read a pack: names, sizes, hashes are checked before anything is used; nothing is written outside its folder."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tdgbench.archives import Member, opened_zip
from tdgbench.files import in_mb, whole_folder
from tdgbench.packs import manifest
from tdgbench.packs.manifest import MANIFEST_FILE, MOST_MANIFEST, Manifest


@contextmanager
def opened_pack(path: Path) -> Iterator[Path]:
    """Yield the results folder of a pack, in a temporary folder; a folder is yielded as it is. Raises as `unpack`."""
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
    try:
        with opened_zip(path) as members:
            return _extract_members(members, folder)
    except FileNotFoundError as error:
        raise FileNotFoundError(f"{path} does not exist") from error
    except ValueError as error:
        raise ValueError(f"{path} is no pack, or damaged or changed: {error}") from error


def _extract_members(members: dict[str, Member], folder: Path) -> tuple[Manifest, str]:
    """Unpack the members of a pack: what they state is checked before any of them is read."""
    manifest.check_amount(members)
    stated = members.pop(MANIFEST_FILE, None)
    if stated is None or stated.size > MOST_MANIFEST:
        raise ValueError(f"it has no {MANIFEST_FILE} of at most {in_mb(MOST_MANIFEST)}")
    text = b"".join(stated.chunks())
    content = manifest.read_manifest(text)
    for name in sorted(set(members) ^ set(content.files)):
        raise ValueError(f"{name} is {'not in the manifest' if name in members else 'missing'}")
    for name, expected in content.files.items():
        if expected.size > (most := manifest.most_bytes(name)):
            raise ValueError(f"{name} has {in_mb(expected.size)}, more than {in_mb(most)}")
        if expected.size != members[name].size:
            raise ValueError(f"{name} is not what the manifest states")
    free = shutil.disk_usage(folder).free
    if sum(member.size for member in members.values()) > free:
        raise ValueError(f"the disk has {in_mb(free)} left, which is less than it would unpack to")
    for name, expected in content.files.items():
        target, digest = folder / name, hashlib.sha256()
        target.parent.mkdir(parents=True, exist_ok=True)
        with target.open("xb") as out:
            for chunk in members[name].chunks():
                out.write(chunk)
                digest.update(chunk)
        if digest.hexdigest() != expected.sha256:
            raise ValueError(f"{name} is not what the manifest states")
    return content, manifest.sha256(text)

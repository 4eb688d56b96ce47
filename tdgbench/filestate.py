"""States of files, which tell whether they have changed, in most cases without reading them."""

from __future__ import annotations

import hashlib
import os
import stat
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

RECENT_SECONDS = 2.5  # a file that is changed twice so shortly may keep its times: FAT notes them to 2 s


class FileState(NamedTuple):
    """State of a file.

    is_recent: the file was so young that a later change may have left size and times as they were. sha256: of its
    content; None if it was not read, as that of recent files always is.
    """

    size: int
    modified_ns: int
    changed_ns: int  # of content, name or permissions; no program can set it back
    sha256: str | None
    is_recent: bool

    def is_of(self, path: Path) -> bool:
        """Whether a file still has the content that it had. One whose times have changed is read, if need be."""
        try:
            now = path.stat()
            if (now.st_size, now.st_mtime_ns, now.st_ctime_ns) == self[:3] and not self.is_recent:
                return True
            is_alike = now.st_size == self.size and stat.S_ISREG(now.st_mode)
            return is_alike and self.sha256 is not None and sha256(path) == self.sha256
        except OSError:
            return False


CHANGED = FileState(-1, 0, 0, None, True)  # no file has this state


@dataclass
class States:
    """States by absolute path. names: hash of the names in a folder; trees: of everything below it."""

    files: dict[str, FileState] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)
    trees: dict[str, str] = field(default_factory=dict)

    def add_file(self, path: Path, state: FileState) -> None:
        """Note a state; the first one of a path stays."""
        self.files.setdefault(str(path.absolute()), state)

    def add_names(self, folder: Path) -> None:
        """Note the names in a folder. One that cannot be listed counts as changed."""
        self.names.setdefault(str(folder.absolute()), _hash_of_names(folder, below=False))

    def add_tree(self, folder: Path) -> None:
        """Note the names of everything below a folder. One that cannot be listed counts as changed."""
        self.trees.setdefault(str(folder.absolute()), _hash_of_names(folder, below=True))

    def is_now(self) -> bool:
        """Whether all files and names are as they were."""
        return (
            all(names and _hash_of_names(Path(folder), below=False) == names for folder, names in self.names.items())
            and all(names and _hash_of_names(Path(folder), below=True) == names for folder, names in self.trees.items())
            and all(state.is_of(Path(path)) for path, state in self.files.items())
        )


def state_of(path: Path) -> FileState:
    """State of a file, which is read only if it is recent; CHANGED for what is no file, which is never opened."""
    try:
        before = path.stat()
        if not stat.S_ISREG(before.st_mode):
            return CHANGED
        state = made_state(before, None)
        return state._replace(sha256=sha256(path)) if state.is_recent else state
    except OSError:
        return CHANGED


def made_state(before: os.stat_result, digest: str | None) -> FileState:
    """State of a file from what the system said before it was read, and the SHA-256 of its content."""
    is_recent = max(before.st_mtime_ns, before.st_ctime_ns) > time.time_ns() - int(RECENT_SECONDS * 1e9)
    return FileState(before.st_size, before.st_mtime_ns, before.st_ctime_ns, digest, is_recent)


def states_of(paths: Iterable[Path], trees: Iterable[Path] = ()) -> States:
    """States of files and of the names below folders."""
    found = States()
    for path in paths:
        found.add_file(path, state_of(path))
    for folder in trees:
        found.add_tree(folder)
    return found


def merged(parts: Iterable[States]) -> States | None:
    """All states together; None where two of them disagree, since something changed between them."""
    whole = States()
    for part in parts:
        for path, state in part.files.items():
            if whole.files.setdefault(path, state)[:3] != state[:3]:
                return None
        for found, given in ((whole.names, part.names), (whole.trees, part.trees)):
            if any(found.setdefault(folder, names) != names for folder, names in given.items()):
                return None
    return whole


def _hash_of_names(folder: Path, *, below: bool) -> str:
    """Hash of the names in a folder, or of all paths below it, links followed; empty if one cannot be listed."""
    names, visited, pending = [], set(), [str(folder.absolute())]
    while pending:
        place = pending.pop()
        real = os.path.realpath(place)
        if real in visited:
            continue
        visited.add(real)
        try:
            entries = [(entry.path, entry.is_dir()) for entry in os.scandir(place)]
        except OSError:
            return ""
        names += [path + os.sep * is_folder for path, is_folder in entries]
        pending += [path for path, is_folder in entries if is_folder and below]
    return hashlib.sha256("\0".join(sorted(names)).encode("utf-8", "surrogateescape")).hexdigest()


def sha256(path: Path) -> str:
    """SHA-256 of a file's content, read piece by piece."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

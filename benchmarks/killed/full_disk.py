"""`python -m benchmarks.killed.full_disk N FOLDER WORDS`: `tdgbench` with a disk that is full from the N-th write on.

Counted are writes below FOLDER: opening a file to write, fsync, rename, making a folder. From the N-th on they fail
with ENOSPC and leave what a full disk leaves: an empty or a cut file. N = 0: none fails, and their number goes to
FOLDER.writes.
"""

from __future__ import annotations

import atexit
import builtins
import errno
import io
import os
import runpy
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


class FullDisk:
    """Counts writes below a folder; those from number `first` on fail (0: none does)."""

    def __init__(self, first: int, folder: Path) -> None:
        self.first, self.folder, self.count = first, str(folder.resolve()), 0

    def install(self) -> None:
        """Replace the functions that write, for the rest of the process."""
        builtins.open = io.open = self._opening(io.open)  # type: ignore[assignment]
        os.fsync = self._flushing(os.fsync)  # type: ignore[assignment]
        os.mkdir = self._placing(os.mkdir)
        os.replace = self._placing(os.replace)
        os.rename = self._placing(os.rename)

    def _fails(self, path: Any) -> bool:
        """Count a write to a path; whether it fails."""
        if not isinstance(path, str | os.PathLike) or not os.path.abspath(path).startswith(self.folder):  # noqa: PTH100
            return False
        self.count += 1
        return 0 < self.first <= self.count

    def _opening(self, real: Callable[..., Any]) -> Callable[..., Any]:
        def open_file(file: Any, mode: str = "r", *rest: Any, **options: Any) -> Any:
            opened = real(file, mode, *rest, **options)
            if set(mode) & set("wax") and self._fails(file):
                opened.close()
                raise _no_space(file)
            return opened

        return open_file

    def _flushing(self, real: Callable[[int], None]) -> Callable[[int], None]:
        def fsync(descriptor: int) -> None:
            path = os.readlink(f"/proc/self/fd/{descriptor}")  # noqa: PTH115
            if self._fails(path):
                os.ftruncate(descriptor, os.fstat(descriptor).st_size // 2)
                raise _no_space(path)
            real(descriptor)

        return fsync

    def _placing(self, real: Callable[..., None]) -> Callable[..., None]:
        def place(path: Any, *rest: Any, **options: Any) -> None:
            if self._fails(path):
                raise _no_space(path)
            real(path, *rest, **options)

        return place


def _no_space(path: Any) -> OSError:
    return OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def main(first: int, folder: Path, words: list[str]) -> None:
    disk = FullDisk(first, folder)
    if first == 0:
        atexit.register(lambda: folder.with_name(f"{folder.name}.writes").write_text(str(disk.count), encoding="utf-8"))
    disk.install()
    sys.argv = ["tdgbench", *words]
    runpy.run_module("tdgbench", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:])

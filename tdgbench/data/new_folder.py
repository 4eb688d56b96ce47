"""Folders that commands make."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tdgbench.bench.lock import file_lock
from tdgbench.files import whole_folder
from tdgbench.scenes import SceneError
from tdgbench.scenes.inputs import is_there


@contextmanager
def new_folder(out: Path) -> Iterator[Path]:
    """Yield a folder to fill, which becomes `out` at the end; after an error, `out` does not exist.

    Raises SceneError if it exists, or if another process is writing it.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    with file_lock(out.with_name(f".{out.name}.lock")) as acquired:
        if not acquired:
            raise SceneError(f"another process is writing {out}; wait for it, or choose another folder")
        if is_there(out):
            raise SceneError(f"{out} is there already; choose another folder, or remove it")
        with whole_folder(out) as part:
            yield part

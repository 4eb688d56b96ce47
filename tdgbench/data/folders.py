"""Folders that commands make: whole or not at all, at once or in stages."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path

from tdgbench import __version__
from tdgbench.files import file_lock, whole_folder
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


class Stages:
    """Finished stages, kept until the result is whole: a run that was stopped goes on after them.

    Each is in a folder that is named by all that its results depend on.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self._key = folder, f"{__version__} {version('pycolmap')}"

    def make(self, name: str, inputs: object, write: Callable[[Path], None]) -> Path:
        """Return the folder of a stage, which `write` fills whole or not at all, unless it is there already.

        inputs: what the results depend on beside earlier stages; its `repr` says all. Results of others are removed.
        """
        self._key = hashlib.sha256(f"{self._key} {name} {inputs!r}".encode()).hexdigest()[:16]
        place = self.folder / f"{name}-{self._key}"
        if not place.is_dir():
            for other in self.folder.glob(f"*{name}-*"):
                shutil.rmtree(other)
            with whole_folder(place) as part:
                write(part)
        return place

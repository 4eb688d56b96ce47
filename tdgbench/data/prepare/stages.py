"""Finished stages of a preparation, kept until the scene is whole: a run that was stopped goes on after them."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

from tdgbench import __version__
from tdgbench.files import whole_folder


class Stages:
    """Stages in their order, each in a folder that is named by all that its results depend on."""

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

"""`.download.json` of a scene: what was downloaded, so that a second run fetches nothing and damage is found."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from tdgbench.scenes.errors import SceneError
from tdgbench.scenes.inputs import hash_of, is_there, read_bytes

FILE = ".download.json"
_CLOSED = ConfigDict(extra="forbid")

Size = Annotated[int, Field(ge=0)]
Sha256 = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]


@dataclass(frozen=True, config=_CLOSED)
class Content:
    """Content of a file: size in bytes and SHA-256."""

    size: Size
    sha256: Sha256

    @classmethod
    def of(cls, path: Path) -> Content:
        """Content of a file on disk. Raises SceneError."""
        return cls(size=path.stat().st_size, sha256=hash_of(path).hex())


@dataclass(frozen=True, config=_CLOSED)
class SceneRecord:
    """What a scene was made of.

    page: where it is published. downloads: identity of each published file, by path. scenes: all that these files hold.
    files: content of each file of the scene, by path.
    """

    page: str
    downloads: dict[str, str]
    scenes: list[str]
    files: dict[str, Content]

    def write(self, scene: Path) -> None:
        """Write the record into a scene's folder, which is not in its place yet."""
        text = json.dumps(asdict(self), indent=1, ensure_ascii=False)
        (scene / FILE).write_text(text + "\n", encoding="utf-8")

    def damage(self, scene: Path, report: Callable[[int], None]) -> list[str]:
        """Paths of files that are missing or differ. All are read; `report` is called with the size of each."""
        damaged = []
        for path, content in self.files.items():
            if not _has(scene / path, content):
                damaged.append(path)
            report(content.size)
        return damaged


_RECORD = TypeAdapter(SceneRecord)


def read_record(scene: Path) -> SceneRecord | None:
    """The record of a scene; None for a scene that was not downloaded by this program. Raises SceneError."""
    path = scene / FILE
    if not is_there(path):
        return None
    try:
        return _RECORD.validate_json(read_bytes(path))
    except ValidationError as error:
        raise SceneError(
            f"{path} is damaged; remove it: the scene counts as not fetched by this command then"
        ) from error


def _has(path: Path, content: Content) -> bool:
    try:
        return path.stat().st_size == content.size and hash_of(path).hex() == content.sha256
    except (OSError, SceneError):
        return False

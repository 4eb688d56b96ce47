"""`manifest.json` of a pack: its files, with sizes and hashes. The hash of the manifest names the pack."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from tdgbench.cells.record import Sha256
from tdgbench.packs.limits import NAME, check_place
from tdgbench.scenes import SceneError

FILE = "manifest.json"
SHOWN = 12  # digits of a pack's hash in its file's name


@dataclass(frozen=True)
class PackedFile:
    """Size in bytes and SHA-256 of a file."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    size: Annotated[int, Field(ge=0)]
    sha256: Sha256


@dataclass(frozen=True)
class Manifest:
    """experiment: its name. version: of tdgbench that packed it. files: by relative path."""

    __pydantic_config__ = ConfigDict(extra="forbid")

    experiment: Annotated[str, Field(pattern=f"^{NAME}$")]
    version: Annotated[str, Field(pattern=r"^[\w.+-]{1,60}$")]
    files: dict[str, PackedFile]
    format: Literal[1] = 1

    def to_json(self) -> bytes:
        """Return the text of the file: equal manifests have equal bytes."""
        return (json.dumps(asdict(self), indent=1, sort_keys=True) + "\n").encode()


def sha256(content: bytes) -> str:
    """Return SHA-256 of bytes. That of its manifest names a pack, as it decides everything in it."""
    return hashlib.sha256(content).hexdigest()


def read_manifest(text: bytes) -> Manifest:
    """Read a manifest. Raises ValueError for what is none, and for paths that lead out of the pack's folder."""
    try:
        manifest = TypeAdapter(Manifest).validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"{'.'.join([FILE, *map(str, first['loc'])])}: {first['msg']}") from error
    for name in manifest.files:
        try:
            check_place(name)
        except (ValueError, SceneError) as error:
            raise ValueError(f"{FILE}: {error}") from error
    return manifest

"""Verdicts on disk: one JSON file for each GPU model, driver, CUDA, torch, gsplat and version of the check."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, with_config
from typing_extensions import TypedDict  # pydantic refuses that of typing before Python 3.12

from tdgbench.bench.backend_check.check import Verdict
from tdgbench.bench.reading import read_text
from tdgbench.files import write_text
from tdgbench.splats.cpu.cache import cache_home, fingerprinted_files
from tdgbench.text import one_line

Identity = dict[str, str | None]  # what a verdict depends on, by name
NotNegative = Annotated[float, Field(ge=0)]
CLOSED = ConfigDict(extra="forbid", allow_inf_nan=False)


@with_config(CLOSED)
class _Verdict(TypedDict):
    """Fields of Verdict."""

    reason: str
    image: NotNegative | None
    gradients: NotNegative | None
    spread: NotNegative | None
    seconds: NotNegative
    is_lasting: bool


@with_config(CLOSED)
class _File(TypedDict):
    identity: dict[str, str | None]
    verdict: _Verdict


@cache
def check_version() -> str:
    """Hash of the sources of the check, and of the splat core that it runs: 16 hexadecimal digits."""
    own = sorted(Path(__file__).parent.glob("*.py"))
    digest = hashlib.sha256()
    for path in [*own, *fingerprinted_files()]:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def place_of(identity: Identity) -> Path:
    """File of the verdict on what an identity names. Raises RuntimeError where there is no folder for caches."""
    name = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]
    return cache_home() / "backend_checks" / f"{name}.json"


def read_verdict(path: Path, identity: Identity) -> Verdict | None:
    """The stored verdict; None if there is none. Raises ValueError for a file that is not the verdict on `identity`."""
    if not os.path.lexists(path):
        return None
    try:
        content: _File = TypeAdapter(_File).validate_json(read_text(path), strict=True)
    except FileNotFoundError as error:
        raise ValueError("it is a link to nothing") from error
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        place = ".".join(map(str, ("$", *problem["loc"])))
        raise ValueError(f"{place}: {one_line(problem['msg'])}") from error
    if content["identity"] != identity:
        raise ValueError("it is the verdict on another GPU or on other versions")
    return Verdict(**content["verdict"])


def write_verdict(path: Path, identity: Identity, verdict: Verdict) -> None:
    """Write a verdict, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps({"identity": identity, "verdict": asdict(verdict)}, indent=1, allow_nan=False) + "\n")


def as_json(verdict: Verdict) -> str:
    """A verdict as text."""
    return json.dumps(asdict(verdict), allow_nan=False)


def verdict_of(text: str) -> Verdict:
    """The verdict in a text of `as_json`."""
    content: Any = TypeAdapter(_Verdict).validate_json(text, strict=True)
    return Verdict(**content)

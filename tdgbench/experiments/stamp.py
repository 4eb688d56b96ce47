"""`finished.json`, by which a repeated command finds, before anything heavy is imported, that nothing has changed.

It holds for one command, for one state of what cells are made from (code, configuration, packages, every path that the
configuration names) and for one state of the results. A file's state is its name, size and times.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException
from pydantic import TypeAdapter, ValidationError

from tdgbench.files import write_text
from tdgbench.resources import PACKAGE, conf_folder, paper_tables_folder
from tdgbench.terminal import say

FILE = "finished.json"
RESULTS = ("cells", "tables", "report.html", "strip.png", "experiment.json")
BASIC_SWEEPER = "hydra._internal.core_plugins.basic_sweeper.BasicSweeper"  # runs the cells that the command names
RESOLVER = re.compile(r"\$\{\s*([\w.]+)\s*:")
DECIDED = {"hydra", "now", "oc.select", "oc.dict.keys", "oc.dict.values"}  # resolvers that read configuration alone
TARGET = re.compile(r"_target_\s*[:=]\s*(\w+)")
OWN = {"tdgbench", "methods", "hydra"}  # packages whose classes read no files but those that the configuration names


@dataclass(frozen=True)
class Stamp:
    """A finished sweep: hashes of its inputs and results, and what a run prints that finds all of its cells."""

    inputs: str
    results: str
    errors: list[str]  # lines on standard error
    text: str
    findings: list[str]


def tell_unchanged(experiment: Path, inputs: str | None) -> bool:
    """Print the results of a finished sweep whose stamp fits; False, and nothing printed, otherwise."""
    try:
        stamp = TypeAdapter(Stamp).validate_json((experiment / FILE).read_bytes())
    except (OSError, ValidationError):
        return False
    if inputs is None or stamp.inputs != inputs or stamp.results != results_hash(experiment):
        return False
    for line in stamp.errors:
        say(line, stderr=True)
    say(stamp.text)
    for sentence in stamp.findings:
        say(sentence, "found:", "bold")
    return True


def leave_stamp(experiment: Path, stamp: Stamp) -> None:
    """Write a stamp. Raises OSError."""
    write_text(experiment / FILE, TypeAdapter(Stamp).dump_json(stamp).decode() + "\n")


def inputs_hash(cfg: DictConfig) -> str | None:
    """Return a hash of all that the cells of a command depend on.

    None where that is not known: cells run whatever is there, a sweeper chooses them, or plug-ins or values come from
    elsewhere.
    """
    hydra, plain = cfg.hydra, cfg.copy()
    with open_dict(plain):
        del plain["hydra"]
    words = [OmegaConf.to_yaml(part) for part in (plain, hydra.overrides, hydra.sweeper)]
    sources = [source for source in hydra.runtime.config_sources if source.schema == "file"]
    text = "\n".join(
        [
            *words,
            *(path.read_text(encoding="utf-8") for source in sources for path in Path(source.path).rglob("*.yaml")),
        ]
    )
    is_decided = set(RESOLVER.findall(text)) <= DECIDED and set(TARGET.findall(text)) <= OWN
    if hydra.sweeper._target_ != BASIC_SWEEPER or cfg.overwrite == "always" or not is_decided:
        return None
    try:
        values = list(_leaves(OmegaConf.to_container(plain, resolve=True)))
    except OmegaConfBaseException:
        return None
    named = chain(values, *(re.split("[=,]", word) for word in hydra.overrides.task))
    paths = {Path(name): None for name in named if name and os.path.lexists(name)}
    state = hash_of_files([*_code(), *paths], Path(str(cfg.results)))
    asked = [text, str(hydra.mode), str(Path.cwd()), sys.version, *_installed(), *values]
    return hashlib.sha256("\0".join([state, *asked]).encode("utf-8", "surrogateescape")).hexdigest()


def results_hash(experiment: Path) -> str:
    """Return a hash of what a sweep wrote."""
    return hash_of_files([experiment / name for name in RESULTS])


def hash_of_files(paths: Iterable[Path], skipped: Path | None = None) -> str:
    """Return a hash of the names, sizes and times of files, and of those below folders, but for the folder `skipped`.

    Links are followed, but no folder is entered twice.
    """
    digest, visited = hashlib.sha256(), {os.path.realpath(skipped)} if skipped else set[str]()

    def add(path: Path) -> None:
        with suppress(OSError):
            found = path.stat()
            state = "" if path.is_dir() else f"{found.st_size} {found.st_mtime_ns} {found.st_ctime_ns}"
            digest.update(f"{path.absolute()}\0{state}\0".encode("utf-8", "surrogateescape"))

    for path in (path for path in paths if os.path.realpath(path) not in visited):
        add(path)
        for place, folders, files in os.walk(path, followlinks=True):
            entered = os.path.realpath(place) not in visited
            visited.add(os.path.realpath(place))
            folders[:] = sorted(name for name in folders if entered and name != "__pycache__")
            for name in [*folders, *sorted(files)] if entered else []:
                add(Path(place, name))
    return digest.hexdigest()


def _leaves(content: Any) -> Iterator[str]:
    """Yield all keys and values of a configuration, as text."""
    if isinstance(content, dict | list):
        for item in chain(*content.items()) if isinstance(content, dict) else content:
            yield from _leaves(item)
    else:
        yield str(content)


def _code() -> Iterator[Path]:
    """Yield the folders of tdgbench's sources and of the data files that cells and tables are made from."""
    yield from (PACKAGE, conf_folder(), paper_tables_folder())
    methods = importlib.util.find_spec("methods")
    if methods is not None:
        yield from map(Path, methods.submodule_search_locations or ())


def _installed() -> list[str]:
    """Return the names, with versions, of the installed packages."""
    folders = dict.fromkeys(Path(entry) for entry in sys.path if entry)
    return [str(path) for folder in folders for path in sorted(folder.glob("*.dist-info"))]

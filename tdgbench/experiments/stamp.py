"""`finished.json`: what a finished sweep was made of and what it made, so that the same command need not check cells.

It is read before anything heavy is imported. It fits as long as the command, the configuration, the code, the installed
packages, the inputs of all cells and the results are what they were; otherwise the sweep takes its ordinary course.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import re
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf, open_dict
from pydantic import TypeAdapter, ValidationError

from tdgbench.files import write_text
from tdgbench.filestate import States
from tdgbench.resources import PACKAGE, conf_folder, paper_tables_folder
from tdgbench.terminal import say

FILE = "finished.json"
BASIC_SWEEPER = "hydra._internal.core_plugins.basic_sweeper.BasicSweeper"  # runs the cells that the command names
INSTALLED = ("hydra.", "hydra_plugins.")  # packages with configurations, which change only with their version
RESOLVER = re.compile(r"\$\{\s*([\w.]+)\s*:")
DECIDED = ("hydra", "now", "oc.select", "oc.dict.keys", "oc.dict.values")  # resolvers that read configuration alone


@dataclass(frozen=True)
class Told:
    """What a run that finds all of its cells prints: lines on standard error, text on standard output, findings."""

    errors: list[str]
    text: str
    findings: list[str]


@dataclass(frozen=True)
class Stamp:
    """A finished sweep. command: hash of everything but files of data that the sweep depends on."""

    command: str
    inputs: States
    results: States
    told: Told

    def fits(self, command: str) -> bool:
        """Whether a command would find everything as the sweep left it."""
        return self.command == command and self.results.is_now() and self.inputs.is_now()

    def write(self, experiment: Path) -> None:
        write_text(experiment / FILE, json.dumps(asdict(self)) + "\n")


def read_stamp(experiment: Path) -> Stamp | None:
    """The stamp in an experiment's folder; None if there is none that can be read."""
    try:
        return TypeAdapter(Stamp).validate_json((experiment / FILE).read_bytes())
    except (OSError, ValidationError, RecursionError):
        return None


def tell_unchanged(cfg: DictConfig, command: str | None) -> bool:
    """Print the results of a finished sweep whose stamp fits the command; False, and nothing printed, otherwise."""
    stamp = None if command is None else read_stamp(Path(str(cfg.results)) / str(cfg.name))
    if command is None or stamp is None or not stamp.fits(command):
        return False
    for line in stamp.told.errors:
        say(line, stderr=True)
    say(stamp.told.text)
    for sentence in stamp.told.findings:
        say(sentence, "found:", "bold")
    return True


def command_hash(cfg: DictConfig) -> str | None:
    """Hash of a command: its configuration, the files that its jobs' configurations are composed of, code, packages.

    None where that does not decide what the jobs are: their values come from elsewhere, or the sweeper chooses them.
    """
    hydra = cfg.hydra
    if hydra.sweeper._target_ != BASIC_SWEEPER:
        return None
    plain = cfg.copy()
    with open_dict(plain):
        del plain["hydra"]
    asked = {
        "config": OmegaConf.to_container(plain, resolve=False),
        "words": [*hydra.overrides.task, OmegaConf.to_container(hydra, resolve=False)["sweeper"]],  # type: ignore[index,call-overload]
        "mode": str(hydra.mode),
        "folder": str(Path.cwd()),
    }
    text = json.dumps(asked, default=str, sort_keys=True)
    digest = hashlib.sha256(text.encode("utf-8", "surrogateescape"))
    for source in hydra.runtime.config_sources:
        if source.schema == "file":
            text += _hash_folder(digest, Path(source.path), "*.yaml")
        elif source.schema != "structured" and not f"{source.path}.".startswith(INSTALLED):
            return None
    if not set(RESOLVER.findall(text)) <= set(DECIDED):
        return None
    for folder in _code():
        _hash_folder(digest, folder, "*")
    digest.update("\0".join([sys.version, *_installed()]).encode())
    return digest.hexdigest()


def _hash_folder(digest: Any, folder: Path, pattern: str) -> str:
    """Add paths and contents of a folder's files to a hash, caches left out; the text of YAML files is returned."""
    texts = []
    for path in sorted(folder.rglob(pattern)):
        if "__pycache__" in path.parts or not path.is_file():
            continue
        content = path.read_bytes()
        digest.update(f"{path}\0{len(content)}\0".encode("utf-8", "surrogateescape") + content)
        if path.suffix == ".yaml":
            texts.append(content.decode("utf-8", "replace"))
    return "\n".join(texts)


def _code() -> Iterator[Path]:
    """Folders of tdgbench's sources and of the data files that tables are made from."""
    yield from (PACKAGE, conf_folder(), paper_tables_folder())
    methods = importlib.util.find_spec("methods")
    if methods is not None:
        yield from map(Path, methods.submodule_search_locations or ())


def _installed() -> list[str]:
    """Names, with versions, of the installed packages."""
    folders = dict.fromkeys(Path(entry) for entry in sys.path if entry)
    return [str(path) for folder in folders for path in sorted(folder.glob("*.dist-info"))]

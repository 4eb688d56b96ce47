"""Classes that a record may name: those of conf/, and methods and metrics that this command line trusts.

Records are data: a `_target_` in one is compared with these names and never imported itself.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from hydra.utils import get_class
from omegaconf import OmegaConf

from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder, import_from_working_folder
from tdgbench.text import shortened
from tdgbench.training.method import Method

_TRUSTED: set[str] = set()  # methods, as `_target_` names them, and metrics, as `metrics.extra` does


class UnknownMethodError(ValueError):
    """A record names a method that is neither tdgbench's nor trusted. The message says how to trust it."""


def add_trust_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --config-dir and --trust, with which a user runs methods and metrics of their own on stored cells."""
    parser.add_argument("--config-dir", type=Path, action="append", default=[], metavar="DIR",
                        help="folder of your YAML files; its methods and metrics are run")  # fmt: skip
    parser.add_argument("--trust", action="append", default=[], metavar="MODULE.NAME",
                        help="a method of yours that may be run, its _target_, or a metric")  # fmt: skip


def trust(config_dirs: Iterable[Path] = (), targets: Iterable[str] = ()) -> None:
    """Trust methods and metrics of folders of YAML files, and of these names, and no others.

    Modules in the working folder are imported for them. Raises ValueError for a folder without such a file.
    """
    _TRUSTED.clear()
    trust_also(targets)
    for folder in config_dirs:
        files = {group: sorted((folder / group).glob("*.yaml")) for group in ("method", "metrics")}
        extra = [name for path in files["metrics"] for name in OmegaConf.select(OmegaConf.load(path), "extra") or ()]
        found = {*_targets(files["method"]), *extra}
        if not found:
            raise ValueError(
                f"--config-dir {folder}: {folder / 'method'} has no YAML file with a _target_, "
                f"{folder / 'metrics'} none with `extra`"
            )
        trust_also(found)


def trust_also(names: Iterable[str]) -> None:
    """Trust methods and metrics of these names beside those that are trusted."""
    _TRUSTED.update(names)
    if _TRUSTED:
        import_from_working_folder()


def extra_of(metrics: Any) -> list[str]:
    """Return the metrics of the user that options of `metrics` in a record name. Raises ValueError if not trusted."""
    names = (isinstance(metrics, dict) and metrics.get("extra")) or []
    for name in names if isinstance(names, list) else [names]:
        if not isinstance(name, str) or name not in _TRUSTED:
            shown = shlex.quote(shortened(str(name), 80))
            raise ValueError(
                f"metric {shown} is none of tdgbench's and was not run: if it is yours, name it with --trust {shown}, "
                "or the folder of its YAML with --config-dir"
            )
    return list(names)


def names_of(record: Record) -> set[str]:
    """Return the names of a record's method and extra metrics, as --trust takes them."""
    extra = record.setting("metrics.extra")
    names = [record.setting("method.method._target_"), *(extra if isinstance(extra, list) else [])]
    return {name for name in names if isinstance(name, str)}


def method_of(record: Record) -> Method:
    """Return the method of a record with its options.

    Raises UnknownMethodError if it is neither known nor trusted, ValueError if it cannot be made.
    """
    options = record.setting("method.method")
    target = options.get("_target_") if isinstance(options, dict) else None
    if not isinstance(target, str) or target not in known_classes("method") | _TRUSTED:
        name = shlex.quote(shortened(str(target), 80))
        raise UnknownMethodError(
            f"method {record.method} is none of tdgbench's and was not run: if its class is yours, name it with "
            f"--trust {name}, or the folder of its YAML with --config-dir"
        )
    try:
        method = built(options, known_classes("method") | _TRUSTED)
        if not isinstance(method, Method):
            raise TypeError(f"{target} is no method")
    except (Exception, SystemExit) as error:  # a class of the user may raise anything
        reason = f"method {record.method} cannot be made as in its record ({error or type(error).__name__})"
        raise ValueError(f"{reason}; run this where its file is, with the version that trained it") from error
    return method


@cache
def known_classes(group: str) -> frozenset[str]:
    """Return the names of classes that the files of a group of conf/ make, options of reading among them.

    >>> "methods.tdg.TDg" in known_classes("method")
    True
    """
    folder = conf_folder()
    return frozenset(_targets([*(folder / group).glob("*.yaml"), folder / "read_options.yaml"]))


def built(options: Any, known: frozenset[str] | set[str]) -> Any:
    """Return what a configuration describes; each `_target_` must be known. Nothing is interpolated.

    Raises ValueError for another `_target_`, and for other words of Hydra.
    """
    if isinstance(options, list):
        return [built(value, known) for value in options]
    if not isinstance(options, dict):
        return options
    target = options.get("_target_")
    for name, value in options.items():
        if (name == "_target_" and target not in known) or (name.startswith("_") and name != "_target_"):
            raise ValueError(f"{name} is {shortened(repr(value), 80)}, which is not known")
    values = {name: built(value, known) for name, value in options.items() if name != "_target_"}
    make: Callable[..., Any] = dict if target is None else get_class(target)
    return make(**values)


def _targets(files: Iterable[Path]) -> Iterator[str]:
    for path in files:
        yield from _named(OmegaConf.to_container(OmegaConf.load(path), resolve=False))


def _named(content: Any) -> Iterator[str]:
    """Yield every `_target_` in a configuration."""
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        if key == "_target_" and isinstance(value, str):
            yield value
        elif isinstance(value, dict | list):
            yield from _named(value)

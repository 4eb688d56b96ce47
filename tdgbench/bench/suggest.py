"""Options and choices that a mistyped one may have meant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from difflib import get_close_matches
from functools import cache
from typing import Any

from omegaconf import OmegaConf

from tdgbench.resources import conf_folder

NO_OPTIONS = ("experiment", "hydra")  # folders of conf/ whose files set options of others


def option_meant(option: str) -> str:
    """`; did you mean …?` with the options that end alike or are spelled alike; empty if there is none.

    An option of other choices than the configured one comes with these.

    >>> option_meant("iterations")
    '; did you mean budget.iterations?'
    >>> option_meant("bugdet.iterations")
    '; did you mean budget.iterations?'
    >>> option_meant("budget.growth.z")
    '; it belongs to budget=lean'
    >>> option_meant("colour")
    ''
    """
    known, last = option_names(), option.rpartition(".")[2]
    if known.get(option):
        return f"; it belongs to {', '.join(known[option])}"
    alike = [name for name in known if name.rpartition(".")[2] == last] if "." not in option else []
    return meant(option, known) if not alike else f"; did you mean {' or '.join(alike[:3])}?"


def meant(word: str, known: Iterable[str]) -> str:
    """`; did you mean …?` with the known words that are spelled alike; empty if there is none.

    >>> meant("tgd", ["tdg", "msmg"])
    '; did you mean tdg?'
    """
    alike = get_close_matches(word, list(known), n=1, cutoff=0.6)
    return f"; did you mean {alike[0]}?" if alike else ""


def choices(group: str) -> list[str]:
    """Built-in choices of a group of options.

    >>> choices("metrics")
    ['3dgs', 'standard']
    """
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


@cache
def option_names() -> dict[str, list[str]]:
    """Dotted names of all options in conf/, with the choices that have them; none for options that are always there."""
    folder, names = conf_folder(), dict[str, list[str]]()
    for path in sorted(folder.rglob("*.yaml")):
        groups = path.relative_to(folder).parts[:-1]
        if groups[:1] not in [(one,) for one in NO_OPTIONS]:
            content = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
            for name in _names(content, "".join(f"{group}." for group in groups)):
                names.setdefault(name, []).extend([f"{'/'.join(groups)}={path.stem}"] if groups else [])
    return names


def _names(content: Any, prefix: str) -> Iterator[str]:
    for key, value in content.items() if isinstance(content, dict) else ():
        if key in ("defaults", "hydra", "_target_"):
            continue
        yield f"{prefix}{key}"
        yield from _names(value, f"{prefix}{key}.")

"""Options of a training that are not those of its method's, prior's, initial points' and budget's files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, cast

from omegaconf import DictConfig, OmegaConf

from tdgbench.cells.key import as_json, flat, with_rules
from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder
from tdgbench.tables import methods
from tdgbench.text import as_typed, shortened

GROUPS = ("method", "prior", "init")


def overrides_of(record: Record) -> list[str]:
    """Return the recorded options that differ from tdgbench's files, as the command line has them.

    Files of a user are not compared, nor what a file leaves open: `???`, references, and null in a prior's.

    >>> config = {"method": {"method": {"lambda_depth": 0.0}}}
    >>> overrides_of(Record("tdg", "synthetic", "orbit", "colmap", 0, "", "", config=config))
    ['method.method.lambda_depth=0.0']
    """
    found = []
    names = {"method": record.method, "prior": str(record.setting("prior.name")), "init": record.init}
    for group in GROUPS:
        options, filed = record.config.get(group), _filed(group, names[group])
        if isinstance(options, dict) and filed is not None:
            differ = {name: value for name, value in flat(options).items() if filed.get(name, "nothing") != value}
            found += [f"{group}.{name}={as_typed(value)}" for name, value in differ.items()
                      if not (name in filed and _is_open(group, filed[name]))]  # fmt: skip
    return found


def override_notes(records: Iterable[Record], column: Callable[[Record], str]) -> list[str]:
    """Return a note for each column with such options that its name does not tell."""
    found: dict[str, dict[str, None]] = {}
    for record in records:
        told = set(map(_last_part, record.variant.split(",")))
        untold = [one for one in overrides_of(record) if _last_part(one) not in told]
        found.setdefault(column(record), {}).update(dict.fromkeys(untold))
    return [f"not as its file says: {methods.label(name)}: {', '.join(them)}" for name, them in found.items() if them]


def training_in_words(record: Record) -> str:
    """Return the budget of a training, and its options that are not those of the budget's file.

    >>> budget = {"name": "demo", "sh_degree": 0}
    >>> training_in_words(Record("tdg", "synthetic", "orbit", "colmap", 0, "", "", config={"budget": budget}))
    'budget demo with sh_degree=0'
    """
    if record.made_elsewhere is not None:
        return "made elsewhere"
    return _budget_in_words(*(json.dumps(record.setting(name), sort_keys=True) for name in ("budget", "method")))


@cache
def _budget_in_words(budget: str, method: str) -> str:
    options = json.loads(budget)
    if not isinstance(options, dict) or not isinstance(options.get("name"), str):
        return "budget n/a"
    name, stated_by_file = options["name"], filed("budget", options["name"])
    if stated_by_file is None:
        return f"budget {name} of {options.get('iterations')} iterations"
    stated = json.loads(method)
    known = stated.items() if isinstance(stated, dict) else ()
    plain = {n: v for n, v in known if not isinstance(v, dict | list) and "$" not in str(v)}  # nothing is resolved
    whole = OmegaConf.create({"method": plain, "budget": stated_by_file})
    usual, own = (
        with_rules(flat({"budget": part}))
        for part in (as_json(OmegaConf.to_container(whole.budget, resolve=True)), options)
    )
    changed = [f"{n.removeprefix('budget.')}={as_typed(v)}" for n, v in own.items() if n in usual and usual[n] != v]
    return shortened(f"budget {name}{' with ' * bool(changed)}{', '.join(changed)}")


def _last_part(override: str) -> str:
    return override.partition("=")[0].rpartition(".")[2]


def _is_open(group: str, stated: Any) -> bool:
    return "$" in str(stated) or stated == "???" or (group == "prior" and stated is None)


@cache
def _filed(group: str, name: str) -> dict[str, Any] | None:
    """Return the options in a file of tdgbench by dotted name; None without the file."""
    stated = filed(group, name)
    return None if stated is None else flat(as_json(OmegaConf.to_container(stated)))


def filed(group: str, name: str) -> DictConfig | None:
    """Return the options in a file of tdgbench over those of its `defaults`, unresolved; None without the file."""
    folder = conf_folder() / group
    if f"{name}.yaml" not in {path.name for path in folder.glob("*.yaml")}:
        return None
    stated: Any = OmegaConf.load(folder / f"{name}.yaml")
    bases = [filed(group, base) for base in stated.pop("defaults", ()) if base != "_self_"]
    return cast(DictConfig, OmegaConf.merge(*filter(None, bases), stated))

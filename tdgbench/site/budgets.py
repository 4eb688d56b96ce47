"""Budgets in words: which trainings of two packs are alike enough to be ranked beside each other."""

from __future__ import annotations

import json
from functools import cache

from omegaconf import OmegaConf

from tdgbench.cells.key import as_json, flat
from tdgbench.cells.record import Record
from tdgbench.resources import conf_folder
from tdgbench.text import as_typed, shortened


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
    name, path = options["name"], conf_folder() / "budget" / f"{options['name']}.yaml"
    if path.name != f"{name}.yaml" or not path.is_file():
        return f"budget {name} of {options.get('iterations')} iterations"
    stated = json.loads(method)
    known = stated.items() if isinstance(stated, dict) else ()
    plain = {n: v for n, v in known if not isinstance(v, dict | list) and "$" not in str(v)}  # nothing is resolved
    whole = OmegaConf.create({"method": plain, "budget": OmegaConf.load(path)})
    usual = flat(as_json(OmegaConf.to_container(whole.budget, resolve=True)))
    changed = [f"{n}={as_typed(v)}" for n, v in flat(options).items() if n in usual and usual[n] != v]
    return shortened(f"budget {name}{' with ' * bool(changed)}{', '.join(changed)}")

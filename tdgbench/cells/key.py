"""Key of a cell: hash of everything its result depends on (configuration, data, code), and what changed in it."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Hashable, Mapping, Sequence
from typing import Any

from omegaconf import DictConfig, OmegaConf

from tdgbench.cells.record import Record
from tdgbench.scoring.backbones import own_weights
from tdgbench.training.method import Method

_OF_TABLES = ("label", "order", "compared_with")  # keys of a method's file that tables alone read
LACKING = object()


def relevant_config(cfg: DictConfig, method: Method) -> dict[str, Any]:
    """Return the part of the configuration that a result depends on, as JSON can hold it."""
    plain: dict[str, Any] = as_json(OmegaConf.to_container(cfg, resolve=True))
    loader = _without_root(plain["dataset"]["loader"])
    return {
        "dataset": loader,
        "init": plain["init"],
        "prior": plain["prior"] if method.needs_prior else None,
        "method": {k: v for k, v in plain["method"].items() if k not in _OF_TABLES},
        "backend": plain["backend"],
        "budget": plain["budget"],
        "metrics": relevant_metrics(plain["metrics"]),
        "skip": plain["skip"],
        "thermal_camera": plain["thermal_camera"],
        "seed": plain["seed"],
    }


def relevant_metrics(metrics: dict[str, Any]) -> dict[str, Any]:
    """Return options of metrics as records keep them: which weights LPIPS has, not whether they may be downloaded."""
    lpips = {k: v for k, v in metrics["lpips"].items() if k != "download"}
    own = own_weights(lpips["net"], lpips["weights"])
    named = {k: v for k, v in metrics.items() if k != "extra" or v}
    return {**named, "lpips": {**lpips, "weights_sha256": own} if own else lpips}


def _without_root(loader: dict[str, Any]) -> dict[str, Any]:
    """Return a loader's options without its folder; also of a loader inside of it."""
    return {k: _without_root(v) if k == "inner" else v for k, v in loader.items() if k != "root"}


def as_json(value: Any) -> Any:
    """Return a value as JSON can hold it: text for numbers that are not finite and for all that is no plain data.

    Halves of characters, as in names of files that are not UTF-8, become escapes.

    >>> as_json({"rate": float("inf"), "sizes": (1, 2.5), 3: None})
    {'rate': 'inf', 'sizes': [1, 2.5], '3': None}
    """
    if isinstance(value, dict):
        return {str(name): as_json(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(item) for item in value]
    if value is None or isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)):
        return value
    return str(value).encode("utf-8", "backslashreplace").decode()


def cell_key(record: Record) -> str:
    """Return the hash of the configuration, data, scene and code in a record: 32 hexadecimal digits.

    >>> record = Record("tdg", "paper", "Truck", "colmap", 0, "table1", "")
    >>> cell_key(record)
    '842371dd379ba6205b90e832234243b1'
    """
    content = {"config": record.config, "data": record.data, "scene": record.scene, "code": record.code}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def why_differs(old: Record, new: Record) -> list[str]:
    """Return differences between the keys of two records, in words; none where the keys are equal.

    >>> old, new = (Record("tdg", "paper", "Truck", "colmap", 0, "table1", "", key=key) for key in "ab")
    >>> old.config, new.config = {"budget": {"iterations": 10}}, {"budget": {"iterations": 20}}
    >>> why_differs(old, new)
    ['budget.iterations: 10 → 20']
    """
    if old.key == new.key:
        return []
    texts = [{k: json.dumps(v) for k, v in flat(record.config).items()} for record in (old, new)]
    changes = [f"{name}: {a} → {b}" for name, (a, b) in sorted(differences(texts, "nothing").items())]
    if old.failure is not None and not old.code:  # it ended before its files and code were known
        return (changes if old.config else []) or [f"what failed in {old.failure.phase}"]
    if old.scene_files != new.scene_files:
        changes.append("the scene's files changed")
    if old.data.removeprefix(old.scene_files) != new.data.removeprefix(new.scene_files):
        changes.append("the files of its renders, model or prior changed")
    if old.code != new.code:
        changes.append("the code changed")
    return changes


def differences(cells: Sequence[Mapping[Any, Hashable]], lacking: Hashable = LACKING) -> dict[Any, tuple[Any, ...]]:
    """Return the values of each setting in which cells differ. lacking: of one that a cell lacks; by default any value.

    >>> differences([{"seed": 0, "size": 9}, {"seed": 1}])
    {'seed': (0, 1)}
    """
    names = dict.fromkeys(name for settings in cells for name in settings)
    values = {name: tuple(settings.get(name, lacking) for settings in cells) for name in names}
    return {name: of_cells for name, of_cells in values.items() if len({*of_cells} - {LACKING}) > 1}


def flat(config: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested options by dotted name.

    >>> flat({"budget": {"iterations": 9, "density": {"every": 100}}})
    {'budget.iterations': 9, 'budget.density.every': 100}
    """
    named: dict[str, Any] = {}
    for name, value in config.items():
        named |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return named


def with_rules(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return `flat` options, and those that hold them as `on`: so a rule that is null differs from one that is set.

    >>> with_rules({"budget.plateau": None, "budget.growth.views": 4})
    {'budget.plateau': None, 'budget.growth': 'on', 'budget.growth.views': 4}
    """
    named: dict[str, Any] = {}
    for name, value in options.items():
        parts = name.split(".")
        named |= {".".join(parts[:count]): "on" for count in range(2, len(parts))} | {name: value}
    return named

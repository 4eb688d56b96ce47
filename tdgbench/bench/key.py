"""What a result depends on: its part of the configuration, the data, the code; and which of them changed."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from omegaconf import DictConfig, OmegaConf

from tdgbench.bench.record import Record
from tdgbench.training.method import Method

_OF_TABLES = ("label", "order", "compared_with")  # keys of a method's file that tables alone read


def relevant_config(cfg: DictConfig, method: Method) -> dict[str, Any]:
    """The part of the configuration that the result depends on."""
    plain: dict[str, Any] = OmegaConf.to_container(cfg, resolve=True)  # type: ignore[assignment]
    loader = {k: v for k, v in plain["dataset"]["loader"].items() if k != "root"}
    metrics = json.loads(json.dumps(plain["metrics"]))
    metrics["lpips"].pop("download")
    return {
        "dataset": loader,
        "init": plain["init"],
        "prior": plain["prior"] if method.needs_prior else None,
        "method": {k: v for k, v in plain["method"].items() if k not in _OF_TABLES},
        "backend": plain["backend"],
        "budget": plain["budget"],
        "metrics": metrics,
        "skip": plain["skip"],
        "seed": plain["seed"],
    }


def cell_key(record: Record) -> str:
    """Names a result by what its record says that it depends on."""
    content = {"config": record.config, "data": record.data, "scene": record.scene, "code": record.code}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def why_differs(old: Record, new: Record) -> list[str]:
    """Which parts of the key changed, in words; empty where the keys are the same."""
    if old.key == new.key:
        return []
    before, after = _flat(old.config), _flat(new.config)
    said = [
        f"{name}: {_shown(before, name)} → {_shown(after, name)}"
        for name in sorted({*before, *after})
        if before.get(name, _NOTHING) != after.get(name, _NOTHING)
    ]
    if old.data != new.data:
        said.append("the scene's files changed")
    if old.code != new.code:
        said.append("the code changed")
    return said


_NOTHING = object()


def _flat(config: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested options by their dotted names."""
    flat: dict[str, Any] = {}
    for name, value in config.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _shown(flat: dict[str, Any], name: str) -> str:
    return json.dumps(flat[name]) if name in flat else "nothing"

"""`experiment.json`: the plan of a sweep, written at its start, read by its cells and its tables."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from tdgbench.files import write_text

FILE = "experiment.json"
# Keys that are part of a cell's path or do not concern it.
IN_THE_PATH = ("method", "dataset", "scene", "init", "seed", "name", "results")


@dataclass
class Plan:
    """Kind of table; scenes, methods and inits of the sweep; other keys with several values."""

    table: str = "main"
    scenes: list[dict[str, str]] = field(default_factory=list)  # scene, dataset, group
    methods: list[str] = field(default_factory=list)
    inits: list[str] = field(default_factory=list)
    variant_keys: list[str] = field(default_factory=list)

    def write(self, experiment: Path) -> None:
        experiment.mkdir(parents=True, exist_ok=True)
        write_text(experiment / FILE, json.dumps(asdict(self), indent=1) + "\n")

    def variant(self, overrides: list[str]) -> str:
        """Overrides of a job that distinguish its cell from others with the same path.

        >>> Plan(variant_keys=["budget"]).variant(["method=tdg", "budget=demo"])
        'budget=demo'
        """
        chosen = [o.lstrip("+~") for o in overrides if o.lstrip("+~").split("=")[0] in self.variant_keys]
        return ",".join(sorted(chosen))


def read_plan(experiment: Path) -> Plan:
    """Read the plan in an experiment's folder; the default plan if there is none."""
    path = experiment / FILE
    return Plan(**json.loads(path.read_text(encoding="utf-8"))) if path.exists() else Plan()


def swept(config: DictConfig) -> dict[str, list[str]]:
    """Swept keys and their values, from the command line or else from the experiment file."""
    params = OmegaConf.select(config, "hydra.sweeper.params") or {}
    written = [f"{k}={v}" for k, v in params.items()] + list(config.hydra.overrides.task)
    values: dict[str, list[str]] = {}
    for override in OverridesParser.create().parse_overrides(written):
        if override.is_sweep_override():
            values[override.key_or_group] = [_as_text(v) for v in override.sweep_iterator()]
        else:
            values.pop(override.key_or_group, None)
    return values


def _as_text(value: object) -> str:
    return value if isinstance(value, str) else Override._get_value_element_as_str(value)  # type: ignore[arg-type]

"""What an experiment is to show: written when it starts, read by its cells and by its tables."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from tdgbench.files import write_text

FILE = "experiment.json"
# Keys that the path of a cell already says.
IN_THE_PATH = ("method", "dataset", "scene", "init", "seed", "name", "results")


@dataclass
class Plan:
    """Kind of table; the scenes, methods and inits asked for; the further keys that the sweep goes over."""

    table: str = "main"
    scenes: list[dict[str, str]] = field(default_factory=list)  # scene, dataset, group
    methods: list[str] = field(default_factory=list)
    inits: list[str] = field(default_factory=list)
    variant_keys: list[str] = field(default_factory=list)

    def write(self, experiment: Path) -> None:
        experiment.mkdir(parents=True, exist_ok=True)
        write_text(experiment / FILE, json.dumps(asdict(self), indent=1) + "\n")

    def variant(self, overrides: list[str]) -> str:
        """Those of a job's overrides that set its cell apart from others with the same path."""
        chosen = [o.lstrip("+~") for o in overrides if o.lstrip("+~").split("=")[0] in self.variant_keys]
        return ",".join(sorted(chosen))


def read_plan(experiment: Path) -> Plan:
    """The plan of an experiment's folder; a main table of whatever is there if none was written."""
    path = experiment / FILE
    return Plan(**json.loads(path.read_text())) if path.exists() else Plan()


def swept(config: DictConfig) -> dict[str, list[str]]:
    """The keys that a sweep goes over and their values (from the command line, else from the experiment file)."""
    params = OmegaConf.select(config, "hydra.sweeper.params") or {}
    written = [f"{k}={v}" for k, v in params.items()] + list(config.hydra.overrides.task)
    values: dict[str, list[str]] = {}
    for override in OverridesParser.create().parse_overrides(written):
        if override.is_sweep_override():
            values[override.key_or_group] = [_plain(v) for v in override.sweep_iterator()]
        else:
            values.pop(override.key_or_group, None)
    return values


def _plain(value: object) -> str:
    return value if isinstance(value, str) else Override._get_value_element_as_str(value)  # type: ignore[arg-type]

"""`experiment.json`: the plan of a sweep, written at its start, read by its cells and its tables."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, QuotedString
from omegaconf import DictConfig, OmegaConf
from pydantic import AliasChoices, ConfigDict, Field, TypeAdapter, ValidationError

from tdgbench.cells.read_files import read_text
from tdgbench.files import write_text
from tdgbench.scenes import Description

PLAN_FILE = "experiment.json"
OF_A_CELL = ("method", "dataset", "scene", "init", "seed")
IN_THE_PATH = (*OF_A_CELL, "name", "results")  # keys that are part of a cell's path or do not concern it
SET_ALONE = ("scene", "seed")  # options that no file and no other option depends on
LAST = 1000  # order of a method that names none
LONGEST_LABEL = 100  # characters


class MethodEntry(NamedTuple):
    """How tables print a method, as its file says: label, order of its column, baseline."""

    label: Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)]
    order: int = LAST
    compared_with: str | None = None


class MetricEntry(NamedTuple):
    """How tables print a metric of the user, as its description says."""

    label: Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)]
    meaning: Annotated[str, Field(max_length=1000)]
    unit: Annotated[str, Field(max_length=20)]
    digits: Annotated[int, Field(ge=0, le=9)]
    higher_is_better: bool
    limits: tuple[float | None, float | None]  # None: infinite
    images: Annotated[str, Field(max_length=100)]


Entry = TypeVar("Entry", MethodEntry, MetricEntry)


@dataclass
class Command:
    """A command that was run into an experiment's folder: its words, without folders of the machine, and when (UTC)."""

    words: str
    date: str


@dataclass
class Plan:
    """Kind of table; scenes, methods and inits of the sweep; other keys with several values; cells that have data.

    commands: that were run into the folder, the last one last; earlier versions do not state them. own_methods: entries
    of methods whose files are in a folder of the user, by name. own_metrics: of numbers by `metrics.extra`, by name.
    """

    __pydantic_config__ = ConfigDict(extra="forbid")

    table: Literal["main", "ablation", "readings"] = "main"
    scenes: list[Description] = field(default_factory=list)
    methods: list[str] = field(default_factory=list)
    inits: list[str] = field(default_factory=list)
    variant_keys: list[str] = field(default_factory=list)
    cells_with_data: Annotated[int, Field(validation_alias=AliasChoices("cells_with_data", "cells_to_run"))] = 0
    commands: list[Command] = field(default_factory=list)
    own_methods: dict[str, MethodEntry] = field(default_factory=dict)
    own_metrics: dict[str, MetricEntry] = field(default_factory=dict)

    def write(self, experiment: Path) -> None:
        experiment.mkdir(parents=True, exist_ok=True)
        write_text(experiment / PLAN_FILE, json.dumps(asdict(self), indent=1) + "\n")

    def variant(self, overrides: list[str]) -> str:
        """Return overrides of a job that distinguish its cell from others with the same path.

        >>> Plan(variant_keys=["budget"]).variant(["method=tdg", "budget=demo"])
        'budget=demo'
        """
        return ",".join(sorted(_with_keys(overrides, self.variant_keys)))

    def title(self, overrides: list[str]) -> str:
        """Return overrides of a job that distinguish its cell from all others.

        >>> Plan(variant_keys=["budget"]).title(["method=tdg", "budget=demo", "threads=1"])
        'method=tdg budget=demo'
        """
        return " ".join(_with_keys(overrides, [*OF_A_CELL, *self.variant_keys]))


def read_plan(folder: Path) -> Plan:
    """Read the plan in a folder; the default plan if there is none. Raises ValueError, naming the file, if broken."""
    path = folder / PLAN_FILE
    try:
        return TypeAdapter(Plan).validate_json(read_text(path), strict=True)
    except FileNotFoundError:
        return Plan()
    except ValueError as error:
        first = error.errors(include_url=False)[0] if isinstance(error, ValidationError) else None
        reason = error if first is None else ": ".join([*(str(part) for part in first["loc"]), first["msg"]])
        raise ValueError(f"{path} is not the plan of a sweep ({reason}); run the sweep again, or delete it") from error


def method_entries(conf: Path, chosen: Sequence[str] = ("*",)) -> dict[str, MethodEntry]:
    """Return the entries of the chosen methods, by default all, in a folder of configuration groups, by name.

    A file's keys count as they stand there; a method does not inherit them from the files that it builds on.
    """
    entries = {}
    for path in sorted(path for choice in chosen for path in (conf / "method").glob(f"{choice}.yaml")):
        content: Any = OmegaConf.load(path)
        name = str(content.get("name", path.stem))
        stated = {key: content[key] for key in MethodEntry._fields if key in content}
        entries[name] = checked(MethodEntry, {"label": name, **stated}, str(path))
    return entries


def checked(kind: type[Entry], stated: dict[str, Any], source: str) -> Entry:
    """Return an entry that a plan can hold. Raises ValueError, naming the source, for what it cannot."""
    try:
        return TypeAdapter(kind).validate_python(stated, strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ValueError(f"{source}: {'.'.join(map(str, first['loc']))} {first['input']!r}: {first['msg']}") from error


def plan_of_job(sweep_folder: Path) -> Plan:
    """Return the plan of a job's sweep. Raises ValueError without one: several jobs might share a cell's folder."""
    if not (sweep_folder / PLAN_FILE).exists():
        raise ValueError(f"{sweep_folder / PLAN_FILE} is missing, the plan of the sweep; run the sweep again")
    return read_plan(sweep_folder)


def swept(config: DictConfig) -> dict[str, list[str]]:
    """Return swept keys and their values as text, from the command line or else from the experiment file.

    The values of a key are empty if the sweeper chooses them.
    """
    values: dict[str, list[str]] = {}
    for override in _overrides(config):
        if override.is_sweep_override():
            discrete = override.is_discrete_sweep()
            values[override.key_or_group] = [_as_text(v) for v in override.sweep_iterator()] if discrete else []
        else:
            values.pop(override.key_or_group, None)
    return values


def swept_over_nothing(config: DictConfig) -> list[str]:
    """Return the keys of sweeps over a list without values, as of a glob that matches nothing."""
    found = [override for override in _overrides(config) if override.is_discrete_sweep()]
    return [override.key_or_group for override in found if not any(True for _ in override.sweep_iterator())]


def number_of_jobs(config: DictConfig) -> int | None:
    """Return the number of jobs of a run or sweep; None if its sweeper decides."""
    return math.prod(len(values) for values in swept(config).values()) or None


class Jobs:
    """The jobs of a sweep, as Hydra's own sweeper makes them: their words, and their composed configurations.

    Hydra takes a fifth of a second to compose one. Jobs that differ in scene and seed alone share one, in which these
    two are set as Hydra sets them: the next call may change the configuration that this one returned.
    """

    def __init__(self, config: DictConfig) -> None:
        self._config, self._composed = config, dict[tuple[str, ...], DictConfig]()
        self.words: list[list[str]] = []
        """Empty for a single run, and where the sweeper decides."""
        if swept(config) and number_of_jobs(config) is not None:
            self.words = [list(job) for job in BasicSweeper.split_arguments(_overrides(config), None)[0]]

    def compose(self, words: Sequence[str]) -> DictConfig:
        """Return the composed configuration of the job with these words."""
        key = tuple(word for word in words if _key(word) not in SET_ALONE)
        loader = GlobalHydra.instance().config_loader()
        if key not in self._composed:
            self._composed[key] = loader.load_sweep_config(self._config, list(words))
        config = self._composed[key]
        alone = OverridesParser.create(loader).parse_overrides([word for word in words if word not in key])
        ConfigLoaderImpl._apply_overrides_to_config(alone, config)
        return config

    def configs_by(self, groups: Sequence[str]) -> Iterator[DictConfig]:
        """Yield composed configurations, one for each choice of the groups and of the options in them.

        Only that of the command itself for a single run, and where the sweeper chooses values.
        """
        if not self.words:
            yield self._config
        by_choice = {tuple(word for word in job if _key(word).split(".")[0] in groups): job for job in self.words}
        yield from map(self.compose, by_choice.values())


def _key(word: str) -> str:
    """Return the key of an override, without the signs before it."""
    return word.lstrip("+~").partition("=")[0]


def _with_keys(overrides: list[str], keys: Sequence[str]) -> list[str]:
    """Return overrides of the given keys, without the signs before them."""
    return [o.lstrip("+~") for o in overrides if _key(o) in keys]


def _overrides(config: DictConfig) -> list[Override]:
    params = OmegaConf.select(config, "hydra.sweeper.params") or {}
    written = [f"{k}={v}" for k, v in params.items()] + list(config.hydra.overrides.task)
    hydra = GlobalHydra.instance()
    return OverridesParser.create(hydra.config_loader() if hydra.is_initialized() else None).parse_overrides(written)


def _as_text(value: object) -> str:
    """Return a value as the text that the job's configuration holds: without the quotes of the command line."""
    if isinstance(value, QuotedString):
        return value.text
    return value if isinstance(value, str) else Override._get_value_element_as_str(value)  # type: ignore[arg-type]

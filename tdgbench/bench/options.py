"""Every option is checked once, where it enters: before the first job, and by each job for what is swept."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from filecmp import cmp
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, Literal, cast

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, NonNegativeFloat, PositiveInt, ValidationError

from tdgbench.bench.signature import (
    STRICT,
    UNKNOWN,
    Problem,
    belongs_to,
    choices,
    impossible_numbers,
    option_meant,
    option_path,
    pydantic_problems,
    signature_problems,
)
from tdgbench.cells.key import flat
from tdgbench.cells.plan import LONGEST_LABEL, method_entries
from tdgbench.cells.prior_sources import PriorSource
from tdgbench.cells.record import LARGEST
from tdgbench.resources import conf_folder
from tdgbench.scenes.modalities import LABELS
from tdgbench.scoring.scored_view import CONVENTIONS, check_convention
from tdgbench.splats.backends import backend_names
from tdgbench.splats.density import GradientKind
from tdgbench.text import meant
from tdgbench.training.budget import RULES
from tdgbench.training.method import Method
from tdgbench.training.skips import no_such_skip

TEXTS = ("name", "scene", "results", "data.root")  # an ordinary name may be a number: name=2024
LONGEST_NAME = 120  # bytes
MOST_THREADS = 1024
OF_THE_CELL = ("name", "results", "scene", "seed", "method", "method.name", "init", "init.name")  # name its folder
EXPERIMENT = "study"  # its class checks the options beside `_target_`


class OptionError(ValueError):
    """Options that are not allowed; the message names all of them, with their values and choices."""

    def __init__(self, problems: list[Problem]) -> None:
        super().__init__("; ".join(dict.fromkeys(map(str, problems))))


def check_options(cfg: DictConfig) -> None:
    """Check a composed configuration, except `hydra` and the options of the experiment itself.

    Options of tdgbench are checked against the models below, those of a `_target_` against its signature. Raises
    OptionError, which names all problems.
    """
    plain, unresolved = _resolved(without_hydra(cfg))
    problems = unresolved or [
        *_model_problems(plain), *_unread(cfg, plain), *_object_problems(plain, ""), *impossible_numbers(plain, ""),
        *_without_effect(plain["budget"]), *_misnamed(plain["metrics"]),
    ]  # fmt: skip
    first: dict[str, Problem] = {}
    for problem in problems:
        name = _typed_name(cfg, problem.option)
        if problem.what.startswith(UNKNOWN):
            more = option_meant(name) if problem.what == UNKNOWN else belongs_to(name)
            problem = problem._replace(what=f"{problem.what}{more}")
        first.setdefault(name, problem._replace(option=name, what=problem.what + _written_in(cfg, name)))
    if first:
        raise OptionError(list(first.values()))


def check_names(cfg: DictConfig) -> None:
    """Check the options that name a cell: without them its result has no place. Raises OptionError."""
    plain, unresolved = _resolved(without_hydra(cfg))
    problems = unresolved or _model_problems(plain)
    of_the_cell = [problem for problem in problems if problem.option in OF_THE_CELL]
    if of_the_cell:
        raise OptionError(of_the_cell)


def check_experiment_options(cfg: DictConfig, options: Callable[..., Any]) -> None:
    """Check the options in `cfg.study` against the signature of a dataclass or function. Raises OptionError."""
    plain, unresolved = _resolved(cfg.study)
    given = {k: v for k, v in plain.items() if k != "_target_"}
    problems = unresolved or signature_problems(options, given, EXPERIMENT)
    if problems:
        raise OptionError(problems)


def check_choices(cfg: DictConfig) -> None:
    """Raise OptionError for files of the user's folders that Hydra does not read, as tdgbench has one of their name."""
    unread = []
    for file in (file for folder in _folders_of_user(cfg) for file in sorted(folder.glob("*/*.yaml"))):
        ours = conf_folder() / file.parent.name / file.name
        if ours.is_file() and not cmp(ours, file, shallow=False):
            unread.append(file)
    if unread:
        more = f" (nor are {len(unread) - 1} more such files)" if unread[1:] else ""
        what = f"is a choice of tdgbench, so {unread[0]} is not read{more}; give the file another name"
        raise OptionError([Problem(unread[0].parent.name, what, unread[0].stem)])


def check_cell_names(cfg: DictConfig, chosen: Mapping[str, Any]) -> None:
    """Check the names of the method and the initial points, by which cells have their folders: none is that of another
    file, of tdgbench or of the user's folders. So is the name of the method's baseline, which must be a method, one of
    the user's folders, or have cells here. chosen: the choices by group. Raises OptionError.
    """
    for group in ("method", "init"):
        name, choice = OmegaConf.select(cfg, f"{group}.name"), chosen.get(group)
        others = [
            *choices(group),
            *(one.stem for folder in _folders_of_user(cfg) for one in folder.glob(f"{group}/*.yaml")),
        ]
        if choice in (None, name) or name not in others:
            continue
        what = f"is another {group}; set `name: {choice}` in {choice}.yaml"
        if choice in choices(group):
            what = f"is the name of another {group}; choose one of your own, such as {group}.name={name}_authors"
        raise OptionError([Problem(f"{group}.name", what, name)])
    baseline = OmegaConf.select(cfg, "method.compared_with")
    experiment = Path(str(cfg.results)) / str(cfg.name)
    known = [*choices("method"), *(path.name for path in (experiment / "cells").glob("*"))]
    if baseline not in (None, *known):
        for file in (file for folder in _folders_of_user(cfg) for file in (folder / "method").glob("*.yaml")):
            known.append(file.stem)
            with suppress(Exception):  # a broken file of another method
                known += method_entries(file.parent.parent, [file.stem])
    if baseline not in (None, *known):
        what = f"is no method, nor has it cells in {experiment}{meant(str(baseline), known)}"
        option = "method.compared_with"
        raise OptionError([Problem(option, what + _written_in(cfg, option), baseline)])


def _hydra_of(cfg: DictConfig) -> Any:
    """Return Hydra's own configuration; None where a configuration was composed without a command."""
    return cfg.get("hydra") or (HydraConfig.get() if HydraConfig.initialized() else None)


def _folders_of_user(cfg: DictConfig) -> list[Path]:
    """Return the folders that --config-dir names."""
    hydra = _hydra_of(cfg)
    sources = () if hydra is None else hydra.runtime.config_sources
    return [Path(source.path) for source in sources if source.provider == "command-line"]


def _written_in(cfg: DictConfig, option: str) -> str:
    """Return ` (in FILE)` for an option of a chosen file of the user's folders that is not typed; else nothing."""
    group, hydra = option.partition(".")[0], _hydra_of(cfg)
    if hydra is None or any(word.lstrip("+").startswith(f"{option}=") for word in hydra.overrides.task):
        return ""
    files = (folder / group / f"{hydra.runtime.choices.get(group)}.yaml" for folder in _folders_of_user(cfg))
    return next((f" (in {path})" for path in files if path.is_file()), "")


def check_typed_names(words: Iterable[str]) -> None:
    """Raise OptionError for typed names of digits and underscores, KEY=VALUE: 2026_11 would be the number 202611.

    >>> check_typed_names(["scene=2026_11"])
    Traceback (most recent call last):
    tdgbench.bench.options.OptionError: scene=2026_11: is read as 202611; put it in quotes: "scene='2026_11'"
    """
    typed = (word.lstrip("+").partition("=") for word in words)
    names = [(key, name.strip()) for key, _, values in typed if key in TEXTS for name in values.split(",")]
    numbers = [(key, name) for key, name in names if re.fullmatch(r"\d+(_\d+)+", name)]
    if numbers:
        what = "is read as {}; put it in quotes: \"{}='{}'\""
        raise OptionError([Problem(k, what.format(n.replace("_", ""), k, n), n) for k, n in numbers])


def without_hydra(cfg: DictConfig) -> DictConfig:
    """Return a composed configuration without Hydra's own options, as a job gets it."""
    return OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key != "hydra"])


def names_to_text(cfg: DictConfig) -> DictConfig:
    """Replace names that were read as whole numbers by text, in place; returns the configuration.

    >>> names_to_text(OmegaConf.create({"name": 2024, "scene": "orbit"})).name
    '2024'
    """
    for option in TEXTS:
        value = OmegaConf.select(cfg, option, throw_on_resolution_failure=False)
        if isinstance(value, int) and not isinstance(value, bool):
            OmegaConf.update(cfg, option, str(value))
    return cfg


def _folder_name(name: str) -> str:
    bad = not name or name.startswith(".") or "/" in name or "\\" in name or not name.isprintable()
    if bad or len(name.encode("utf-8", "replace")) > LONGEST_NAME:
        rule = f"printable, without slashes, not beginning with a dot, at most {LONGEST_NAME} bytes"
        raise ValueError(f"must be the name of one folder: {rule}")
    return name


def _one_word(name: str) -> str:
    if any(c.isspace() or c in "()[]" for c in name):
        raise ValueError("must be one word without brackets: tables print initial points and options behind it")
    return name


def _backend(name: str) -> str:
    choices = ["auto", *backend_names()]
    if name not in choices:
        raise ValueError(f"must be {', '.join(choices[:-1])} or {choices[-1]}")
    return name


def _skips(allowed: dict[str, Any]) -> dict[str, Any]:
    rules = [name for name in allowed if name in RULES]
    if rules:
        raise ValueError(f"{rules[0]} is a rule of the budget: budget.{rules[0]}=null switches it off")
    if problem := no_such_skip(allowed.keys() - {"_target_", "otherwise"}):
        raise ValueError(problem)
    return allowed


def _whole(group: dict[str, Any]) -> dict[str, Any]:
    if "_target_" not in group:
        raise ValueError("lacks `_target_`: begin its file with `defaults: [CHOICE, _self_]`, a file of tdgbench")
    return group


class _Group(BaseModel):
    model_config = ConfigDict(**STRICT, extra="forbid")


class _PlugIn(BaseModel):
    """A group whose choices may come from elsewhere, with keys of their own that its other options refer to."""

    model_config = ConfigDict(**STRICT, extra="allow")


class _Dataset(_PlugIn):
    default_scene: str | None = None
    loader: dict[str, Any]


class _Init(_PlugIn):
    name: Annotated[str, Field(min_length=1), AfterValidator(_one_word)]
    points: dict[str, Any]


class _Prior(_PlugIn):
    name: Annotated[str, Field(min_length=1)]
    made_from: PriorSource
    estimator: dict[str, Any]


class _Method(_PlugIn):
    name: Annotated[str, Field(min_length=1), AfterValidator(_one_word)]
    label: Annotated[str, Field(min_length=1, max_length=LONGEST_LABEL)] | None = None
    order: int | None = None
    compared_with: str | None = None
    paper_iterations: PositiveInt | None = None
    paper_means_steps: PositiveInt | None = None
    paper_density_stop: PositiveInt | None = None
    gradient: GradientKind | None = None
    grad_threshold: NonNegativeFloat | None = None
    method: dict[str, Any]


class _Backend(_Group):
    name: Annotated[str, AfterValidator(_backend)]


class _ThermalCamera(_PlugIn):
    estimate: bool
    rig: bool | Literal["auto"]


class _Data(_Group):
    """Options of all data sets; their values are checked by the loader that they go to."""

    root: Annotated[str, Field(min_length=1)]
    split: Any
    width: Any
    channels: Any
    thermal: Any
    principal_point: Any
    temperature: Any
    fillers: Any


class _Options(_Group):
    """`conf/config.yaml`."""

    dataset: _Dataset
    init: _Init
    prior: _Prior
    method: _Method
    backend: _Backend
    budget: Annotated[dict[str, Any], AfterValidator(_whole)]
    metrics: Annotated[dict[str, Any], AfterValidator(_whole)]
    skip: Annotated[dict[str, Any], AfterValidator(_skips)]
    thermal_camera: _ThermalCamera
    study: dict[str, Any]
    name: Annotated[str, AfterValidator(_folder_name)]
    table: Literal["main", "ablation", "readings"]
    scene: Annotated[str, Field(min_length=1)] | None
    seed: Annotated[int, Field(ge=0, le=LARGEST)]
    overwrite: Literal["only-missing", "always", "never"]
    retry_failed: bool
    checkpoint: NonNegativeFloat | None  # seconds
    threads: Annotated[int, Field(ge=1, le=MOST_THREADS)] | None
    results: Annotated[str, Field(min_length=1)]
    data: _Data


def _model_problems(plain: dict[str, Any]) -> list[Problem]:
    try:
        _Options.model_validate(plain)
    except ValidationError as error:
        return pydantic_problems(error, "")
    return []


def _without_effect(budget: Any) -> Iterator[Problem]:
    """Yield pruning by screen radius, which begins after the first opacity reset, where no round follows one."""
    rules = budget.get("density") if isinstance(budget, dict) else None
    if not isinstance(rules, dict) or not rules.get("screen_radius_prune"):
        return
    names = ("start", "stop", "every", "opacity_reset_every", "round_recovery")
    numbers = [budget.get("iterations"), *map(rules.get, names)]
    if not all(isinstance(number, int) for number in numbers) or rules["every"] < 1:
        return  # others say what is wrong
    iterations, start, stop, every, reset, recovery = cast(list[int], numbers)
    last = min(stop - 1, iterations - recovery * every) // every * every
    if last <= max(start, reset):
        what = f"prunes after the first opacity reset, at {reset}, but the last round is at {max(last, 0)}"
        yield Problem("budget.density.screen_radius_prune", what, True)


def _misnamed(metrics: Any) -> Iterator[Problem]:
    """Yield a convention of scores whose border or range is another one's."""
    names = ("convention", "ssim_border", "lpips_range")
    if isinstance(metrics, dict) and metrics.get("convention") in CONVENTIONS:
        try:
            check_convention(*(str(metrics.get(name)) for name in names))
        except ValueError as error:
            yield Problem("metrics.convention", f"states other scores ({error})", metrics["convention"])


def _unread(cfg: DictConfig, plain: dict[str, Any]) -> Iterator[Problem]:
    """Yield keys of plug-ins' groups that are no option and that no `${group.key}` refers to: misspelt ones."""
    written = str(OmegaConf.to_container(cfg, resolve=False))
    for group, field in _Options.model_fields.items():
        kind, options = field.annotation, plain.get(group)
        if (
            isinstance(kind, type)
            and issubclass(kind, _PlugIn)
            and isinstance(options, dict)
            and "_target_" not in options
        ):
            for key in options:
                if key not in kind.model_fields and f"${{{group}.{key}}}" not in written:
                    yield Problem(f"{group}.{key}", UNKNOWN)


def _object_problems(plain: Any, name: str) -> Iterator[Problem]:
    """Yield problems of every `_target_` in a configuration."""
    for key, item in plain.items() if isinstance(plain, dict) else enumerate(plain) if isinstance(plain, list) else ():
        yield from _object_problems(item, option_path(name, key))
    if isinstance(plain, dict) and "_target_" in plain and name != EXPERIMENT:
        yield from _target_problems(plain, name)


def _target_problems(plain: dict[str, Any], name: str) -> Iterator[Problem]:
    """Yield problems of a `_target_` and of its own options, not of options that have a `_target_` themselves."""
    try:
        if name == "method":
            raise TypeError("it stands below `method:` in the file, with the options of its class")
        target = _import(str(plain["_target_"]))
    except Exception as error:  # a plug-in's module may raise anything
        yield Problem(f"{name}._target_", f"cannot be imported ({type(error).__name__}: {error})", plain["_target_"])
        return
    if name == "method.method" and not (isinstance(target, type) and issubclass(target, Method)):
        rule = f"must be a class that derives from {Method.__module__}.{Method.__name__}"
        yield Problem(f"{name}._target_", rule, plain["_target_"])
        return
    if name == "method.method" and (unknown := set(target.modalities) - set(LABELS)):
        what = f"has modalities {', '.join(sorted(unknown))}; there are {', '.join(LABELS)}"
        yield Problem(f"{name}._target_", what, plain["_target_"])
    nested = [k for k, v in plain.items() if isinstance(v, dict) and "_target_" in v]
    given = {k: v for k, v in plain.items() if not k.startswith("_") and k not in nested}
    yield from signature_problems(target, given, name, elsewhere=nested, partial=bool(plain.get("_partial_")))


def _import(path: str) -> Any:
    """Import `package.module.name`."""
    module, _, name = path.rpartition(".")
    try:
        return resolve_name(f"{module}:{name}")
    except ModuleNotFoundError as error:
        if not module.startswith(str(error.name)):
            raise
        here = [file.stem for file in Path.cwd().glob("*.py")]
        try:
            return resolve_name(path)  # `package.module.Class.name`
        except ModuleNotFoundError as again:
            raise ModuleNotFoundError(f"{again}{meant(module, here)}") from error
    except AttributeError as error:
        raise AttributeError(f"{error}{meant(name, dir(sys.modules.get(module)))}") from error


def _resolved(cfg: DictConfig) -> tuple[dict[Any, Any], list[Problem]]:
    """Return a configuration as plain data; or none, and the problem of the first value that cannot be resolved."""
    try:
        return cast(dict[Any, Any], OmegaConf.to_container(cfg, resolve=True, throw_on_missing=True)), []
    except MissingMandatoryValue as error:
        return {}, [Problem(str(error.full_key), f"is missing; set it with {error.full_key}=VALUE")]
    except OmegaConfBaseException as error:
        return {}, [Problem(str(error.full_key), str(error).splitlines()[0])]


def _typed_name(cfg: DictConfig, name: str) -> str:
    """Return the option that a user sets: `data.width` for `dataset.loader.options.width`, which is `${data.width}`."""
    written = flat(cast(dict[str, Any], OmegaConf.to_container(cfg, resolve=False)))
    for _ in written:  # options may refer to one another in a circle
        refers = re.fullmatch(r"\$\{([a-z_]\w*(?:\.\w+)*)\}", str(written.get(name)))
        if not refers or not any(f"{option}.".startswith(f"{refers.group(1)}.") for option in written):
            break
        name = refers.group(1)
    return name

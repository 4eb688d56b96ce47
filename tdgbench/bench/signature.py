"""Check options against the signature of what they configure: a class named by `_target_`, or a dataclass of options.

The annotations say what is allowed: `Literal["paper", "reference"]`, `PositiveInt`, `Annotated[float, Field(le=1)]`.
Types that YAML does not have are not checked. No number may be infinite or NaN, no integer have more than 64 bits. A
mistyped option comes with those that it may have meant.
"""

from __future__ import annotations

import inspect
import math
import re
import types
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from omegaconf import OmegaConf
from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from tdgbench.cells.record import LARGEST
from tdgbench.resources import conf_folder
from tdgbench.text import as_typed, meant

SCALARS = (int, float, bool, str, type(None), Any)
STRICT = ConfigDict(strict=True, allow_inf_nan=False)
UNKNOWN = "is no option"
NO_OPTIONS = ("experiment", "hydra")  # folders of conf/ whose files set options of others


class Problem(NamedTuple):
    """What is wrong with one option."""

    option: str  # its dotted name
    what: str
    value: Any = None  # shown unless it is None, a list or a dictionary

    def __str__(self) -> str:
        """Return `data.width=0: must be at least 1`."""
        shown = "" if self.value is None or isinstance(self.value, dict | list) else f"={as_typed(self.value)}"
        return f"{self.option}{shown}: {self.what}"


def signature_problems(
    target: Callable[..., Any],
    options: Mapping[str, Any],
    name: str,
    elsewhere: Collection[str] = (),
    partial: bool = False,
) -> list[Problem]:
    r"""Return problems of the options that a class or function is called with.

    options: by parameter. name: of the options as a whole. elsewhere: parameters whose values are checked elsewhere.
    partial: parameters may be missing.

    >>> def resize(width: int, mode: Literal["fast", "good"] = "good"): ...
    >>> print(*signature_problems(resize, {"mode": "best", "depth": 2}, "image"), sep="\n")
    image.width: is missing
    image.mode=best: must be fast or good
    image.depth=2: is no option; there are width, mode
    """
    parameters = inspect.signature(target).parameters
    named = [p for p in parameters.values() if p.kind not in (p.VAR_POSITIONAL, p.VAR_KEYWORD)]
    others = next((p for p in parameters.values() if p.kind is p.VAR_KEYWORD), None)
    hints = _hints(target)
    missing = [p.name for p in named if p.default is p.empty and p.name not in {*options, *elsewhere} and not partial]
    problems = [Problem(f"{name}.{parameter}", "is missing") for parameter in missing]
    for option in [*options, *elsewhere]:
        parameter, value = parameters.get(option, others), options.get(option)
        if parameter is None or parameter.kind is parameter.VAR_POSITIONAL:
            known = ", ".join(p.name for p in named) or "none (does its class lack @dataclass?)"
            problems.append(Problem(f"{name}.{option}", f"is no option; there are {known}", value))
        elif option in options:
            problems += type_problems(hints.get(parameter.name, Any), value, f"{name}.{option}")
    return problems


def type_problems(hint: Any, value: Any, name: str) -> list[Problem]:
    """Return problems of a value that should be of an annotated type.

    >>> [str(problem) for problem in type_problems(int, 2.5, "seed")]
    ['seed=2.5: must be a valid integer']
    >>> [str(problem) for problem in type_problems(bool | Literal["auto"], "maybe", "rig")]
    ['rig=maybe: must be a valid boolean or auto']
    """
    if not _is_plain(hint):
        return [*_not_options(hint, value, name), *impossible_numbers(value, name)]
    try:
        _adapter(hint).validate_python(value)
    except ValidationError as error:
        return pydantic_problems(error, name)
    return list(impossible_numbers(value, name))


def pydantic_problems(error: ValidationError, name: str) -> list[Problem]:
    """Return problems that pydantic found in the options below `name`; one where an option may have several types."""
    found: dict[tuple[int | str, ...], Problem] = {}
    for kind in error.errors(include_url=False):
        place = kind["loc"][:-1] if kind["loc"] and OF_TYPE.fullmatch(str(kind["loc"][-1])) else kind["loc"]
        problem = _problem(kind | {"loc": place}, name)
        if place in found:
            problem = problem._replace(what=f"{found[place].what} or {problem.what.removeprefix('must be ')}")
        found[place] = problem
    return list(found.values())


def impossible_numbers(value: Any, name: str) -> Iterator[Problem]:
    """Yield numbers in a value, its lists and dictionaries included, that are not finite or have more than 64 bits.

    >>> [str(problem) for problem in impossible_numbers({"steps": [7, 2**63]}, "")]
    ['steps[1]=9223372036854775808: must be at most 9223372036854775807']
    """
    if isinstance(value, float) and not math.isfinite(value):
        yield Problem(name, "must be a finite number", value)
    if isinstance(value, int) and not -LARGEST <= value <= LARGEST:
        yield Problem(name, f"must be at most {LARGEST}" if value > 0 else f"must be at least {-LARGEST}", value)
    for key, item in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from impossible_numbers(item, option_path(name, key))


@cache
def _hints(target: Callable[..., Any]) -> dict[str, Any]:
    """Return annotations of a signature; none where they name what is imported for type checkers only.

    Those of a dataclass's fields are resolved in the module of the class that has them.
    """
    found: dict[str, Any] = {}
    for source in (target, target.__init__) if isinstance(target, type) else (target,):  # type: ignore[misc]
        with suppress(NameError):
            found |= get_type_hints(source, include_extras=True)
    return found


@cache
def _adapter(hint: Any) -> TypeAdapter[Any]:
    return TypeAdapter(hint, config=STRICT)


def _is_plain(hint: Any) -> bool:
    """Return whether a type is made of what YAML has."""
    if hint in SCALARS or (isinstance(hint, type) and issubclass(hint, BaseModel)):
        return True
    origin = get_origin(hint)
    if origin is Annotated:
        return _is_plain(get_args(hint)[0])
    return origin is Literal or (origin in (Union, types.UnionType, list, dict) and all(map(_is_plain, get_args(hint))))


def _not_options(hint: Any, value: Any, name: str) -> Iterator[Problem]:
    """Yield the problem of a value in the place of options that a `_target_` makes."""
    kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    if not all(kind is types.NoneType or is_dataclass(kind) for kind in kinds):
        return
    if value is None and types.NoneType not in kinds:
        yield Problem(name, f"may not be null; set its options: {', '.join(f'{name}.{f.name}' for f in fields(hint))}")
    elif value is not None:
        choices = "options with a _target_, or null" if types.NoneType in kinds else "options with a _target_"
        yield Problem(name, f"must be {choices}; choose a configuration that has them", value)


def _problem(error: ErrorDetails, name: str) -> Problem:
    """Return an error of pydantic in the words of options."""
    kind, value, option = error["type"], error["input"], option_path(name, *error["loc"])
    what = error["msg"].removeprefix("Value error, ")
    for phrase, shorter in PHRASES.items():
        what = what.replace(phrase, shorter)
    if kind in WORDS:
        what = WORDS[kind]
    elif kind == "list_type":
        what = f"must be a valid list, such as {option}=[{value if isinstance(value, str) else 'a'}]"
    elif kind == "literal_error":
        what = what.replace("'", "")
    elif kind == "string_type" and isinstance(value, int | float):
        what = f"must be text; put it in quotes: \"{option}='TEXT'\""
    return Problem(option, what, None if kind == "missing" else value)


# The end of the place of a pydantic error, where an option may have several types.
OF_TYPE = re.compile(r"bool|int|float|str|none|(literal|list|dict|constrained|function|nullable)\W.*")
WORDS = {  # by pydantic's type of error, where its own message does not name options
    "missing": "is missing",
    "extra_forbidden": UNKNOWN,
    "string_too_short": "must not be empty",
    "dict_type": "must be a group of options",
    "model_type": "must be a group of options",
}
PHRASES = {  # of its messages, and what replaces them
    "Input should": "must",
    "List should": "must",
    " after validation": "",
    "greater than or equal to": "at least",
    "less than or equal to": "at most",
}


def option_path(name: str, *keys: int | str) -> str:
    """Return the dotted name of what lies in the options `name` below some keys.

    >>> option_path("fillers", 1), option_path("data", "width"), option_path("", "seed")
    ('fillers[1]', 'data.width', 'seed')
    """
    for key in keys:
        name = f"{name}[{key}]" if isinstance(key, int) else f"{name}.{key}" if name else str(key)
    return name


def option_meant(option: str) -> str:
    """Return what an unknown option may be: one of other choices, or one that ends alike or is spelled alike.

    >>> option_meant("iterations")
    '; did you mean budget.iterations?'
    >>> option_meant("bugdet.iterations")
    '; did you mean budget.iterations?'
    >>> option_meant("methd")
    '; did you mean method?'
    >>> option_meant("colour")
    ''
    """
    known = option_names()
    alike = [name for name in known if name.endswith(f".{option}")]
    return belongs_to(option) or (f"; did you mean {' or '.join(alike[:3])}?" if alike else meant(option, known))


def belongs_to(option: str) -> str:
    """Return `; it belongs to …` with the choices of a group that have an option; empty if none has.

    >>> belongs_to("dataset.loader.errors.rig")
    '; it belongs to dataset=synthetic, synthetic_rig'
    """
    owners = option_names().get(option)
    return f"; it belongs to {option.partition('.')[0]}={', '.join(owners)}" if owners else ""


def choices(group: str) -> list[str]:
    """Return built-in choices of a group of options.

    >>> choices("metrics")
    ['3dgs', 'standard']
    """
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml"))


@cache
def option_names() -> dict[str, list[str]]:
    """Return the dotted names of all options in conf/ and of its groups, with the choices of the group that have them.

    Choices that get an option from the file of another one are left out.
    """
    folder, names = conf_folder(), dict[str, list[str]]()
    for path in sorted(folder.rglob("*.yaml")):
        groups = path.relative_to(folder).parts[:-1]
        if groups[:1] not in [(folder,) for folder in NO_OPTIONS]:
            content = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
            names |= {group: [] for group in groups}
            for name in _names(content, "".join(f"{group}." for group in groups)):
                names.setdefault(name, []).extend([path.stem] if groups else [])
    return names


def _names(content: Any, prefix: str) -> Iterator[str]:
    for key, value in content.items() if isinstance(content, dict) else ():
        if key in ("defaults", "hydra", "_target_"):
            continue
        yield f"{prefix}{key}"
        yield from _names(value, f"{prefix}{key}.")

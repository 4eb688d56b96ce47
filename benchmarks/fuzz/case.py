"""A case: one kind of input, mutated by a seed, what runs on it, and when a result is wrong."""

from __future__ import annotations

import importlib
import pkgutil
import random
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple, get_args

from benchmarks.fuzz import kinds as package
from benchmarks.fuzz.child import Ran

Outcome = Literal["result", "error", "hang", "memory", "crash", "traceback", "unnamed", "wrong", "exit-0", "lost"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)
ALLOWED: tuple[Outcome, ...] = ("result", "error")
ERROR_LINE = re.compile(
    r"^(failed|error|problem|tdgbench[\w ]*):|Error|[Cc]ould not|^Key |line \d+:\d+|no viable|mismatched"
)
FAILURE_LINE = re.compile(r"^(failed|error):", re.MULTILINE)


@dataclass(frozen=True)
class Change:
    """What one mutation did, in words. names: an error has to hold one of them. harmful: no result can be right."""

    text: str
    names: tuple[str, ...]
    harmful: bool = False


class Programs(NamedTuple):
    """The programs that cases run: main functions of `tdgbench` and `tdgbench verify`."""

    tdgbench: Callable[[], int]
    verify: Callable[[list[str]], int]


class Kind(ABC):
    """One case of a kind of input: made with a good input in `folder`, then mutated, run in a child, and judged.

    share: of the cases, relative to the other kinds. needs_results: whether `base` must hold good results (results.py).
    words: arguments of `tdgbench`, where the case has some.
    """

    name: ClassVar[str]
    share: ClassVar[int] = 2
    needs_results: ClassVar[bool] = False
    words: Sequence[str] = ()

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        """Copy a good input from `base` (see inputs.py) to `folder`."""
        self.base, self.folder = base, folder

    @abstractmethod
    def mutate(self, rng: random.Random) -> Change:
        """Mutate the input once."""

    @abstractmethod
    def run(self, programs: Programs) -> int:
        """Run the case; the working folder is `folder`. Returns the exit status."""

    @abstractmethod
    def wrong(self) -> str:
        """Why a result (exit status 0) is wrong; empty if it is right."""

    def refused(self) -> str:
        """Why an error is wrong: the input is ordinary. Empty if an error is right."""
        return ""

    def lost(self) -> str:
        """What did not come that has to come whatever the mutation; empty if nothing."""
        return ""


def judge(case: Kind, changes: list[Change], ran: Ran) -> tuple[Outcome, str]:
    """Outcome of a case, and why."""
    if ran.ending == "hang":
        return "hang", f"{ran.seconds:.0f} s"
    if ran.ending == "memory":
        return "memory", f"{ran.megabytes:.0f} MB"
    if ran.ending == "signal":
        return "crash", last_line(ran.output)
    if "Traceback (most recent call last)" in ran.output:
        return "traceback", last_line(ran.output)
    lost = case.lost()
    if lost:
        return "lost", lost
    if ran.status == 0:
        failure = FAILURE_LINE.search(ran.output)
        if failure:
            return "exit-0", last_line(ran.output)
        harm = next((change.text for change in changes if change.harmful), "")
        why = f"a result in spite of: {harm}" if harm else case.wrong()
        return ("wrong", why) if why else ("result", "")
    refused = case.refused()
    if refused:
        return "wrong", f"{refused}: {last_line(ran.output)}"
    lines = [line for line in ran.output.splitlines() if ERROR_LINE.search(line) and not line.startswith("n/a")]
    names = [name for change in changes for name in change.names]
    named = [line for line in lines if any(name in line for name in names)]
    return ("error", named[0]) if named else ("unnamed", last_line(ran.output))


def last_line(text: str) -> str:
    """The last line that is not empty."""
    return next((line for line in reversed(text.splitlines()) if line.strip()), "(no output)")


def find_kinds() -> dict[str, type[Kind]]:
    """Every kind of the modules of `kinds/`, by name.

    >>> {"colmap-old", "images", "options"} <= set(find_kinds())
    True
    """
    found: dict[str, type[Kind]] = {}
    for module in pkgutil.iter_modules(package.__path__):
        for value in vars(importlib.import_module(f"{package.__name__}.{module.name}")).values():
            if isinstance(value, type) and issubclass(value, Kind) and "name" in vars(value):
                found[value.name] = value
    return dict(sorted(found.items()))

"""A stress case: what is done, on which backends, and what is expected of it."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tdgbench.experiments.stress.outcome import Seen


class Expected(Protocol):
    """What a case should show."""

    def judge(self, seen: Seen) -> bool:
        """Whether it does."""


@dataclass(frozen=True)
class Close:
    """Finite, and within these errors of the float64 reference: of the values' range, and of the gradients' norm."""

    image: float = 5e-5
    gradients: float = 2e-4

    def judge(self, seen: Seen) -> bool:
        if seen.error is not None:
            return False
        return self.share(seen) <= 1  # never true of NaN

    def share(self, seen: Seen) -> float:
        """The larger of both errors, as a share of what is allowed; NaN if either is."""
        shares = (seen.numbers["image"] / self.image, seen.numbers["gradients"] / self.gradients)
        return math.nan if any(map(math.isnan, shares)) else max(shares)

    def __str__(self) -> str:
        return f"finite; image within {self.image:g}, gradients within {self.gradients:g}"


@dataclass(frozen=True)
class Raises:
    """One named error, whose message matches a pattern."""

    kind: str
    pattern: str

    def judge(self, seen: Seen) -> bool:
        return seen.error is not None and seen.error == self.kind and re.search(self.pattern, seen.text) is not None

    def __str__(self) -> str:
        return f"{self.kind}: {self.pattern.replace(chr(92), '')}"


@dataclass(frozen=True)
class Holds:
    """A statement in words that the case itself checks; it raises AssertionError with what it saw instead."""

    statement: str

    def judge(self, seen: Seen) -> bool:
        return seen.error is None

    def __str__(self) -> str:
        return self.statement


@dataclass(frozen=True)
class Case:
    """`run(backend)` gives what was seen; a case that concerns no backend runs once, as `once`."""

    family: str
    name: str
    expected: Expected
    run: Callable[[str], Seen]
    every_backend: bool = True


@dataclass(frozen=True)
class Verdict:
    """One row of the table."""

    family: str
    case: str
    backend: str
    expected: str
    seen: str
    passed: bool
    share: float | None  # of the error that is allowed; None where no error is measured
    seconds: float


def judge(case: Case, backend: str) -> Verdict:
    """Run a case on a backend. Never raises: what it raises is what was seen."""
    start = time.perf_counter()
    try:
        seen = case.run(backend)
    except Exception as error:
        seen = Seen(text=str(error).splitlines()[0] if str(error) else "", error=type(error).__name__)
    passed = case.expected.judge(seen)
    seconds = time.perf_counter() - start
    share = case.expected.share(seen) if isinstance(case.expected, Close) and seen.error is None else None
    return Verdict(case.family, case.name, backend, str(case.expected), str(seen), passed, share, round(seconds, 3))

"""A stress case: what it does, on which backends, and what it expects."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE
from tdgbench.experiments.stress.outcome import Observed


class Expected(Protocol):
    """An expectation."""

    def judge(self, observed: Observed) -> bool:
        """Whether the observation fulfils it."""


@dataclass(frozen=True)
class Close:
    """Finite, and close to the float64 reference: errors relative to the values' range, to the gradients' norm."""

    image: float = IMAGE_TOLERANCE
    gradients: float = GRADIENT_TOLERANCE

    def judge(self, observed: Observed) -> bool:
        if observed.error is not None:
            return False
        return self.share(observed) <= 1  # false for NaN

    def share(self, observed: Observed) -> float:
        """The larger error, relative to its limit; NaN if either error is NaN."""
        shares = (observed.numbers["image"] / self.image, observed.numbers["gradients"] / self.gradients)
        return math.nan if any(map(math.isnan, shares)) else max(shares)

    def __str__(self) -> str:
        return f"finite; image within {self.image:g}, gradients within {self.gradients:g}"


@dataclass(frozen=True)
class Raises:
    """An error of a named type whose message matches a pattern."""

    kind: str
    pattern: str

    def judge(self, observed: Observed) -> bool:
        return observed.error == self.kind and re.search(self.pattern, observed.text) is not None

    def __str__(self) -> str:
        return f"{self.kind}: {self.pattern.replace(chr(92), '')}"


@dataclass(frozen=True)
class Holds:
    """A statement that the case itself checks; it raises UnexpectedError with what it observed instead."""

    statement: str

    def judge(self, observed: Observed) -> bool:
        return observed.error is None

    def __str__(self) -> str:
        return self.statement


@dataclass(frozen=True)
class Case:
    """A named case. `run` takes a backend; a case with every_backend=False runs once, with the word `once`."""

    family: str
    name: str
    expected: Expected
    run: Callable[[str], Observed]
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
    share: float | None  # error relative to its limit; None where no error is measured
    seconds: float


def judge(case: Case, backend: str) -> Verdict:
    """Run a case on a backend. An exception is an observation."""
    start = time.perf_counter()
    try:
        observed = case.run(backend)
    except Exception as error:
        observed = Observed(text=str(error).splitlines()[0] if str(error) else "", error=type(error).__name__)
    passed = case.expected.judge(observed)
    seconds = time.perf_counter() - start
    share = case.expected.share(observed) if isinstance(case.expected, Close) and observed.error is None else None
    return Verdict(case.family, case.name, backend, str(case.expected), str(observed), passed, share, round(seconds, 3))

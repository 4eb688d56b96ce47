"""A stress case: what it does, on which backends, what it expects, and what it observed."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE


class UnexpectedError(Exception):
    """A statement of a case does not hold; the message says what was observed instead."""


def require(condition: bool, observed: str) -> None:
    """Raise UnexpectedError unless a condition holds."""
    if not condition:
        raise UnexpectedError(observed)


@dataclass(frozen=True)
class Observed:
    """Numbers or a sentence; or the type of an error and its message."""

    text: str = ""
    numbers: dict[str, float] = field(default_factory=dict)
    error: str | None = None

    def __str__(self) -> str:
        if self.error is not None:
            return f"{self.error}: {self.text}"
        numbers = [f"{name} {value:.1e}" for name, value in self.numbers.items()]
        return "; ".join([self.text, *numbers] if self.text else numbers)


@dataclass(frozen=True)
class Close:
    """Finite, and close to the float64 reference: errors relative to the values' range, to the gradients' norm."""

    image: float = IMAGE_TOLERANCE
    gradients: float = GRADIENT_TOLERANCE

    def allows(self, observed: Observed) -> bool:
        """Return whether both errors are within their limits; NaN is not."""
        return observed.numbers["image"] <= self.image and observed.numbers["gradients"] <= self.gradients

    def __str__(self) -> str:
        return f"finite; image within {self.image:g}, gradients within {self.gradients:g}"


@dataclass(frozen=True)
class Raises:
    """An error of a named type whose message matches a pattern."""

    kind: str
    pattern: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.pattern.replace(chr(92), '')}"


Expected = Close | Raises | str  # a sentence is checked by the case itself, which raises UnexpectedError


@dataclass(frozen=True)
class Case:
    """A named case. `run` takes a backend; a case with every_backend=False runs once, with the word `once`."""

    family: str
    name: str
    expected: Expected
    run: Callable[[str], Observed]
    every_backend: bool = True


@dataclass(frozen=True)
class CaseResult:
    """One row of the table."""

    family: str
    case: str
    backend: str
    expected: str
    seen: str
    passed: bool
    seconds: float


def run_case(case: Case, backend: str) -> CaseResult:
    """Run a case on a backend. An exception is an observation."""
    start, expected = time.perf_counter(), case.expected
    try:
        observed = case.run(backend)
    except Exception as error:
        observed = Observed(text=str(error).partition("\n")[0], error=type(error).__name__)
    if isinstance(expected, Raises):
        passed = observed.error == expected.kind and re.search(expected.pattern, observed.text) is not None
    else:
        passed = observed.error is None and (isinstance(expected, str) or expected.allows(observed))
    seconds = round(time.perf_counter() - start, 3)
    return CaseResult(case.family, case.name, backend, str(expected), str(observed), passed, seconds)

"""A stress case: what it does, on which backends, what it expects, and what it observed."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from tdgbench.bench.backend_check.compare import GRADIENT_TOLERANCE, IMAGE_TOLERANCE, BackendErrors

TOLERANCES = BackendErrors(IMAGE_TOLERANCE, GRADIENT_TOLERANCE)


class UnexpectedError(Exception):
    """A statement of a case does not hold; the message says what was observed instead."""


def require(condition: bool, observed: str) -> None:
    """Raise UnexpectedError unless a condition holds."""
    if not condition:
        raise UnexpectedError(observed)


def close(tolerances: BackendErrors = TOLERANCES) -> str:
    """Say that values and gradients are close to the float64 reference."""
    return f"finite; image within {tolerances.image:g}, gradients within {tolerances.gradients:g}"


def require_close(errors: BackendErrors, tolerances: BackendErrors = TOLERANCES) -> str:
    """Return the errors in words. Raises UnexpectedError unless both are within their tolerances; NaN is not."""
    observed = f"image {errors.image:.1e}; gradients {errors.gradients:.1e}"
    require(all(error <= limit for error, limit in zip(errors, tolerances, strict=True)), observed)
    return observed


class Raises(NamedTuple):
    """An error of a named type whose message matches a pattern."""

    kind: str
    pattern: str

    def __str__(self) -> str:
        return f"{self.kind}: {self.pattern.replace(chr(92), '')}"


@dataclass(frozen=True)
class Case:
    """A named case.

    expected: an error, or a sentence that the case itself checks. run: takes a backend, returns what it observed, and
    raises UnexpectedError if that is not as expected. A case with every_backend=False runs once, with the word `once`.
    """

    family: str
    name: str
    expected: Raises | str
    run: Callable[[str], str]
    every_backend: bool = True


def run_case(case: Case, backend: str) -> dict[str, Any]:
    """Run a case on a backend; return its row of the table. An exception is an observation."""
    start, expected = time.perf_counter(), case.expected
    try:
        seen, passed = case.run(backend), isinstance(expected, str)
    except Exception as error:
        kind, message = type(error).__name__, str(error).partition("\n")[0]
        seen = f"{kind}: {message}"
        passed = isinstance(expected, Raises) and kind == expected.kind and bool(re.search(expected.pattern, message))
    seconds = round(time.perf_counter() - start, 3)
    return {
        "family": case.family, "case": case.name, "backend": backend, "expected": str(expected), "seen": seen,
        "passed": passed, "seconds": seconds,
    }  # fmt: skip

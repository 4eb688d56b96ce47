"""Problems in words. A check that cannot be made becomes one of them and ends no other check."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ParamSpec, TypeVar

from tdgbench.scoring.scored_view import NotApplicableError

P = ParamSpec("P")
T = TypeVar("T")
FAILURES = (Exception, SystemExit)  # a user's method may end the process, which is no success
SAYS_ENOUGH = (ValueError, OSError, NotApplicableError)  # their message needs no type


class NotMade(str):
    """A problem that is no wrong number: a check that could not be made."""


class NotCheckedError(Exception):
    """A check was not made, which is no problem. The message says why."""


class Problems:
    """The problems of one cell, in the order in which they were found."""

    def __init__(self) -> None:
        self.all: list[str] = []

    def check(self, what: str, problems: Callable[P, Iterable[str]], *args: P.args, **kwargs: P.kwargs) -> bool:
        """Add the problems that a check finds; return whether it came to its end.

        An error ends this check alone and is a problem of `what`. Raises NotCheckedError if the check does.
        """
        try:
            for problem in problems(*args, **kwargs):
                self._add(problem)
        except NotCheckedError:
            raise
        except FAILURES as error:
            self._add(NotMade(f"{what} cannot be checked: {reason(error)}"))
            return False
        return True

    def read(self, what: str, reader: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T | None:
        """Return the value of a reader; None, and a problem, if it raises."""
        try:
            return reader(*args, **kwargs)
        except FAILURES as error:
            self._add(f"{what} cannot be read: {reason(error)}")
            return None

    @property
    def not_made(self) -> int:
        """How many of them are checks that could not be made."""
        return sum(isinstance(problem, NotMade) for problem in self.all)

    def _add(self, problem: str) -> None:
        if problem not in self.all:
            self.all.append(problem)


def reason(error: BaseException) -> str:
    """Return an error in words.

    >>> reason(FileNotFoundError()), reason(KeyError("x"))
    ('it is missing', "KeyError: 'x'")
    """
    if isinstance(error, FileNotFoundError):
        return "it is missing"
    if isinstance(error, SAYS_ENOUGH) and str(error):
        return str(error)
    return f"{type(error).__name__}: {error}".removesuffix(": ")

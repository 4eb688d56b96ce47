"""Checks of a training on a GPU whose numbers are still on their way to the host."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType


class Pending:
    """Checks of earlier steps, made when their numbers have arrived; a check raises NonFiniteError of its iteration.

    The loop reads them after the next step has been rendered: there, the host has waited for the number of pairs, which
    the device knows after those numbers. In a `with` statement, they are also read at its end, and what they raise
    comes before a later error.
    """

    def __init__(self) -> None:
        self._checks: list[Callable[[], None]] = []

    def add(self, check: Callable[[], None]) -> None:
        """Make a check at the next `read`."""
        self._checks.append(check)

    def read(self) -> None:
        """Make the checks, in their order; wait for numbers that have not arrived."""
        checks, self._checks = self._checks, []
        for check in checks:
            check()

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None or isinstance(error, Exception):
            self.read()

"""Print to the terminal. Printing never raises: what cannot be printed does not change the outcome of a run."""

from __future__ import annotations

import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any, ParamSpec, TextIO, cast

from rich.console import Console
from rich.text import Text

from tdgbench.text import one_line

Arguments = ParamSpec("Arguments")
# Environment variable: tdgbench shows tracebacks, and Hydra raises its errors instead of printing them.
FULL_ERROR = "HYDRA_FULL_ERROR"
UNPRINTABLE = "backslashreplace"  # how characters outside of the stream's encoding are printed
LONGEST = 10_000  # characters of a message; the help has some 4 000
COLOURS = re.compile("\x1b\\[[0-9;]*m")  # of rich
UNLIMITED = 1_000_000  # width, in characters, where there is no terminal: tables are as wide as their content


def console(stderr: bool = False) -> Console:
    """Return a console on standard output, or on standard error. Its prints never raise, and are flushed.

    On a terminal it has the terminal's width. Elsewhere nothing is cut or wrapped, and it is not interactive, whatever
    the environment says (COLUMNS, FORCE_COLOR).
    """
    stream = _guarded("stderr" if stderr else "stdout")
    if stream.is_terminal():
        return Console(file=cast(TextIO, stream), stderr=stderr)
    return Console(file=cast(TextIO, stream), stderr=stderr, width=UNLIMITED, force_interactive=False)


def say(text: str, label: str = "", style: str = "red", stderr: bool = False) -> None:
    """Print plain text (no markup) without wrapping it; `label`, if any, comes first, in a style of rich.

    What is longer than any message of ours, as of a file that holds megabytes where a number should be, is cut.
    """
    if len(text) > LONGEST:
        text = f"{text[:LONGEST]}… ({len(text) - LONGEST:,} more characters)"
    line = Text.assemble((label, style), " " if label else "", printable(text))
    console(stderr).print(line, highlight=False, soft_wrap=True)


def show_findings(findings: list[str]) -> None:
    """Print what was found. A reader looks for it at the end, so nothing but errors is printed after it."""
    for sentence in findings:
        say(sentence, "found:", "bold")


@contextmanager
def copy_of_prints() -> Iterator[list[str]]:
    """Yield a list that what is printed to standard output meanwhile is added to."""
    before, stream = sys.stdout, _guarded("stdout")
    sys.stdout = cast(TextIO, stream)
    stream.copies = []
    try:
        yield stream.copies
    finally:
        sys.stdout, stream.copies = before, None


def print_again(text: str) -> None:
    """Print what `copy_of_prints` kept. Raises ValueError where a file holds what no print of ours does."""
    plain = COLOURS.sub("", text)
    if plain != printable(plain):
        raise ValueError("it has control characters")
    _guarded("stdout").write(text)


def errors_in_one_line(tool: str, status: int = 1) -> Callable[[Callable[Arguments, int]], Callable[Arguments, int]]:
    """Return a decorator: what a tool's function raises for what it cannot read is one line, and this exit status."""

    def decorate(function: Callable[Arguments, int]) -> Callable[Arguments, int]:
        @wraps(function)
        def run(*arguments: Arguments.args, **options: Arguments.kwargs) -> int:
            try:
                return function(*arguments, **options)
            except (ValueError, OSError) as error:
                say(one_line(f"tdgbench {tool}: {error}"), stderr=True)
                return status

        return run

    return decorate


def printable(text: str) -> str:
    r"""Return the text with control characters, which a terminal would obey, as escapes; line feeds and tabs stay.

    >>> printable("a scene\x1b[2J")
    'a scene\\x1b[2J'
    """
    if text.replace("\n", "").replace("\t", "").isprintable():  # in one pass: pages of the report are long
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


def guard_streams() -> None:
    """Guard `sys.stdout` and `sys.stderr`, also against the interpreter's last flush, which would set the exit status.

    Closed standard streams become the null device, so that no file of the run gets their number.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest free number, which is this one
    sys.stdout, sys.stderr = cast(TextIO, _guarded("stdout")), cast(TextIO, _guarded("stderr"))


class GuardedStream:
    """A text stream whose `write` and `flush` never raise; the first failure is reported on standard error.

    stream: None if it was closed before the process began.
    """

    def __init__(self, name: str, stream: TextIO | None) -> None:
        self.name, self._stream, self._broken = name, stream or io.StringIO(), False
        self.copies: list[str] | None = None  # of what is written
        if stream is None:
            self._stream.close()
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=UNPRINTABLE)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if self.copies is not None:
            self.copies.append(text)
        self._guard(lambda: self._stream.write(text))
        return len(text)

    def writelines(self, lines: list[str]) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        self._guard(self._stream.flush)

    def is_terminal(self) -> bool:
        """Return whether a person reads the stream; never raises."""
        try:
            return self._stream.isatty()
        except (OSError, ValueError):  # ValueError: the stream was closed
            return False

    def _guard(self, call: Callable[[], object]) -> None:
        if not self._broken:
            try:
                call()
            except (OSError, ValueError) as error:  # ValueError: the stream was closed
                self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        """Discard what is buffered and all that follows; report it, unless this is standard error itself."""
        self._broken = True
        try:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self._stream.fileno())
            os.close(null)
        except (OSError, ValueError):  # no file is behind the stream
            self._stream = io.StringIO()
        if self.name == "stdout":
            reason = error.strerror if isinstance(error, OSError) else "it is closed"
            say(f"nothing more is printed to standard output: {reason}", "note:", "yellow", stderr=True)


def _guarded(name: str) -> GuardedStream:
    stream = getattr(sys, name)
    return stream if isinstance(stream, GuardedStream) else GuardedStream(name, stream)

"""HTTP requests that are tried again after a cut connection, an overloaded server or a rate limit."""

from __future__ import annotations

import time
from collections.abc import Mapping
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import NamedTuple, NoReturn

import requests

from tdgbench import __version__
from tdgbench.data.get.errors import GetError
from tdgbench.terminal import say
from tdgbench.text import one_line

HEADERS = {"User-Agent": f"tdgbench/{__version__}", "Accept-Encoding": "identity"}  # offsets count bytes on disk
SAID_SECONDS = 2.0  # shorter waits are not worth a line
REPEATABLE = frozenset({408, 425, 429, 500, 502, 503, 504})  # status codes that may be gone in a moment
PERMANENT = (requests.exceptions.SSLError, requests.exceptions.ProxyError, requests.exceptions.InvalidURL,
             requests.exceptions.MissingSchema, requests.exceptions.InvalidSchema,
             requests.exceptions.TooManyRedirects)  # fmt: skip
CUT = (requests.exceptions.ConnectionError, requests.exceptions.ChunkedEncodingError)
NO_NAME = ("NameResolutionError", "gaierror")  # errors of a name without an address, of urllib3 and of the system


class Patience(NamedTuple):
    """How long failures are put up with.

    attempts: failures in a row, without a byte between them. The wait doubles from `first_seconds` up to
    `longest_seconds`; a server that asks for more than the latter ends the download.
    """

    attempts: int = 6
    first_seconds: float = 2.0
    longest_seconds: float = 120.0
    connect_seconds: float = 15.0
    read_seconds: float = 60.0


PATIENT = Patience()


class RepeatableError(Exception):
    """A request failed in a way that may be gone at the next attempt; `wait_seconds` is what the server asks for."""

    def __init__(self, reason: str, wait_seconds: float | None = None) -> None:
        super().__init__(reason)
        self.wait_seconds = wait_seconds


class Attempts:
    """Counts failures in a row and waits between them; `what` is fetched."""

    def __init__(self, patience: Patience, what: str) -> None:
        self._patience, self._what, self._failures = patience, what, 0

    def failed(self, error: Exception) -> None:
        """Wait before the next attempt. Raises GetError if it makes no sense."""
        reason, asked = reason_of(error), getattr(error, "wait_seconds", None)
        if isinstance(error, PERMANENT):
            raise GetError(f"{self._what} cannot be fetched: {reason}") from error
        self._failures += 1
        if self._failures >= self._patience.attempts:
            raise GetError(
                f"{self._what} cannot be fetched: {reason} ({self._failures} times in a row); run the same command "
                "later: it goes on from what is there"
            ) from error
        if asked is not None and asked > self._patience.longest_seconds:
            raise GetError(
                f"{self._what} cannot be fetched: {reason}; run the same command in {asked:.0f} s"
            ) from error
        wait = min(self._patience.first_seconds * 2 ** (self._failures - 1), self._patience.longest_seconds)
        wait = wait if asked is None else max(asked, 0.0)
        if wait >= SAID_SECONDS:
            say(one_line(f"{reason}; trying again in {wait:.0f} s"), "note:", "yellow", stderr=True)
        time.sleep(wait)

    def succeeded(self) -> None:
        """Bytes have come: failures are counted anew."""
        self._failures = 0


def get(url: str, patience: Patience, headers: Mapping[str, str] | None = None) -> requests.Response:
    """Begin a GET request; the body is streamed and the caller closes it.

    Raises RepeatableError for status codes that may be gone in a moment, GetError for other failures of the server, and
    errors of requests.
    """
    response = requests.get(
        url,
        headers={**HEADERS, **(headers or {})},
        stream=True,
        timeout=(patience.connect_seconds, patience.read_seconds),
    )
    if response.ok or response.status_code == requests.codes.requested_range_not_satisfiable:
        return response
    response.close()
    _refused(response)


def _refused(response: requests.Response) -> NoReturn:
    status = f"the server answers {response.status_code} {response.reason or ''}".rstrip()
    if response.status_code in REPEATABLE:
        raise RepeatableError(status, asked_wait(response.headers, datetime.now(UTC)))
    raise GetError(f"{response.url} cannot be fetched: {status}")


def asked_wait(headers: Mapping[str, str], now: datetime) -> float | None:
    """Seconds to wait by the header Retry-After (seconds or a date, RFC 9110); None without one.

    >>> asked_wait({"Retry-After": "59"}, datetime.now(UTC))
    59.0
    """
    value = headers.get("Retry-After", "").strip()
    if value.isascii() and value.isdigit():
        return float(value)
    try:
        return (parsedate_to_datetime(value) - now).total_seconds()
    except (TypeError, ValueError):  # TypeError: a date without a time zone
        return None


def reason_of(error: BaseException) -> str:
    """Why a request failed, in words, without the inner life of the libraries."""
    if isinstance(error, requests.exceptions.Timeout):
        return "no answer in time"
    if isinstance(error, requests.exceptions.RequestException):
        return _innermost(error) or "the connection was cut"
    return str(error)


def _innermost(error: BaseException) -> str:
    """Text of the system's error behind one of requests, or "" if there is none."""
    seen: list[object] = [error]
    for one in seen:
        if type(one).__name__ in NO_NAME:
            return "the name of the server has no address here (is there a network?)"
        if isinstance(one, OSError) and not isinstance(one, requests.exceptions.RequestException) and one.strerror:
            return one.strerror
        if isinstance(one, BaseException):
            causes = (one.__cause__, one.__context__, getattr(one, "reason", None), *one.args)
            seen += [cause for cause in causes if isinstance(cause, BaseException) and cause not in seen]
    return "" if isinstance(error, CUT) and not isinstance(error, PERMANENT) else str(error)

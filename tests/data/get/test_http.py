from datetime import UTC, datetime

import pytest
import requests

from tdgbench.data.get import http
from tdgbench.data.get.errors import GetError
from tdgbench.data.get.http import Attempts, Patience, RepeatableError, asked_wait, reason_of

NOW = datetime(2026, 11, 22, 8, 0, 0, tzinfo=UTC)


@pytest.mark.parametrize(
    ("value", "seconds"),
    [
        ("0", 0.0),
        (" 60 ", 60.0),
        ("Sun, 22 Nov 2026 08:01:30 GMT", 90.0),
        ("Sun, 22 Nov 2026 07:59:00 GMT", -60.0),
        ("Sun, 22 Nov 2026 08:01:30 -0000", None),  # no time zone
        ("-1", None),
        ("soon", None),
        ("", None),
    ],
)
def test_the_wait_that_a_server_asks_for(value, seconds):
    assert asked_wait({"Retry-After": value}, NOW) == seconds
    assert asked_wait({}, NOW) is None


def test_waits_double_up_to_a_limit_and_begin_anew_after_a_success(monkeypatch):
    waited = []
    monkeypatch.setattr(http.time, "sleep", waited.append)
    attempts = Attempts(Patience(attempts=5, first_seconds=1.0, longest_seconds=3.0), "x")
    for _ in range(4):
        attempts.failed(RepeatableError("503"))
    attempts.succeeded()
    attempts.failed(RepeatableError("503"))
    assert waited == [1.0, 2.0, 3.0, 3.0, 1.0]


@pytest.mark.parametrize(
    "error", [requests.exceptions.SSLError("bad certificate"), requests.exceptions.InvalidURL("x")]
)
def test_errors_that_no_further_attempt_mends(error):
    with pytest.raises(GetError, match=r"^lion\.zip cannot be fetched: (bad certificate|x)$"):
        Attempts(Patience(), "lion.zip").failed(error)


def test_reasons_are_those_of_the_system():
    inner = OSError(113, "No route to host")
    outer = requests.exceptions.ConnectionError("HTTPConnectionPool(host='x', port=80): Max retries exceeded")
    outer.__cause__ = RuntimeError("urllib3")
    outer.__cause__.__context__ = inner
    assert reason_of(outer) == "No route to host"
    assert reason_of(requests.exceptions.ReadTimeout("x")) == "no answer in time"
    assert reason_of(requests.exceptions.ChunkedEncodingError("IncompleteRead")) == "the connection was cut"

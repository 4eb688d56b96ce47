"""The newest request of each client is served, coarse while its camera moves, fine once it rests."""

from __future__ import annotations

import threading

import pytest

from tdgbench.view.requests import Requests
from tests.helpers.waiting import Clock


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def requests(clock) -> Requests[str]:
    return Requests(rest=1.0, now=clock)


def taken(requests: Requests[str]) -> list[tuple[int, str, bool]]:
    """Everything that is due now."""
    return [(job.client, job.wanted, job.is_fine) for job in iter(requests.take, None)]


def test_a_moved_camera_is_coarse_at_once_and_fine_after_a_rest(requests, clock):
    requests.moved(1, "a")
    assert taken(requests) == [(1, "a", False)]
    clock.seconds = 0.9
    assert taken(requests) == []
    clock.seconds = 1.0
    assert taken(requests) == [(1, "a", True)] and taken(requests) == []


def test_motion_puts_the_fine_picture_off(requests, clock):
    requests.moved(1, "a")
    taken(requests)
    clock.seconds = 0.9
    requests.moved(1, "b")
    clock.seconds = 1.5
    assert taken(requests) == [(1, "b", False)]
    clock.seconds = 1.9
    assert taken(requests) == [(1, "b", True)]


def test_outdated_requests_are_dropped(requests):
    for wanted in "abc":
        requests.moved(1, wanted)
    assert taken(requests) == [(1, "c", False)]


def test_a_changed_look_is_fine_at_once(requests):
    requests.moved(1, "a")
    requests.changed(1, "b")
    assert taken(requests) == [(1, "b", True)]


def test_clients_take_turns_and_one_in_motion_starves_none(requests):
    requests.changed(2, "still")
    order = []
    for number in range(3):
        requests.moved(1, str(number))
        requests.moved(3, str(number))
        job = requests.take()
        order.append(job.client)
    assert sorted(order) == [1, 2, 3]


def test_a_picture_is_outdated_by_a_newer_request_and_by_the_client_s_end(requests):
    requests.changed(1, "a")
    job = requests.take()
    assert requests.is_newest(job)
    requests.moved(1, "b")
    assert not requests.is_newest(job)
    newer = requests.take()
    assert requests.is_newest(newer)
    requests.forget(1)
    assert not requests.is_newest(newer) and taken(requests) == []


def test_waiting_ends_with_a_job_with_a_rest_and_with_the_close():
    requests, found = Requests[str](rest=0.05), []
    thread = threading.Thread(target=lambda: found.extend(iter(requests.next, None)))
    thread.start()
    requests.moved(1, "a")
    for _ in range(200):
        if len(found) == 2:
            break
        threading.Event().wait(0.01)
    requests.close()
    thread.join(5)
    assert not thread.is_alive() and [(job.wanted, job.is_fine) for job in found] == [("a", False), ("a", True)]
    assert requests.next() is None

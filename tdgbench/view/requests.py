"""Which picture to render next: the newest of each client, coarse while its camera moves, fine once it rests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")
REST_SECONDS = 0.25  # without a new camera, until the fine picture is rendered


@dataclass(frozen=True)
class RenderJob(Generic[T]):
    """A picture to render for a client."""

    client: int
    wanted: T
    is_fine: bool
    number: int  # of the client's request that it serves


@dataclass
class _Pending(Generic[T]):
    wanted: T
    number: int
    is_coarse_due: bool
    fine_at: float | None  # None once it is served


class Requests(Generic[T]):
    """The newest request of each client. Clients take turns, and a newer request replaces an older one.

    A moved camera is due at once, coarse, and after `rest` seconds without another request, fine. Anything else that
    changes is due at once, fine.
    """

    def __init__(self, rest: float = REST_SECONDS, now: Callable[[], float] = time.monotonic) -> None:
        self._rest, self._now = rest, now
        self._pending: dict[int, _Pending[T]] = {}  # in the order of their turns
        self._changed = threading.Condition()
        self._count = 0
        self._is_closed = False

    def moved(self, client: int, wanted: T) -> None:
        """Request a picture of a camera in motion."""
        self._put(client, wanted, True, self._now() + self._rest)

    def changed(self, client: int, wanted: T) -> None:
        """Request a picture of a camera at rest."""
        self._put(client, wanted, False, self._now())

    def forget(self, client: int) -> None:
        """Drop what a client has requested."""
        with self._changed:
            self._pending.pop(client, None)

    def close(self) -> None:
        """End `next` for all who wait."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def is_newest(self, request: RenderJob[T]) -> bool:
        """Return whether the client is there and has requested nothing since."""
        with self._changed:
            pending = self._pending.get(request.client)
            return pending is not None and pending.number == request.number

    def next(self) -> RenderJob[T] | None:
        """Wait for the next request that is due; None once closed."""
        with self._changed:
            while not self._is_closed:
                request = self.take()
                if request is not None:
                    return request
                times = [request.fine_at for request in self._pending.values() if request.fine_at is not None]
                self._changed.wait(max(0.0, min(times) - self._now()) if times else None)
            return None

    def take(self) -> RenderJob[T] | None:
        """Return the next request that is due; None if there is none now."""
        with self._changed:
            for client, pending in self._pending.items():
                is_fine = not pending.is_coarse_due
                if is_fine and (pending.fine_at is None or pending.fine_at > self._now()):
                    continue
                self._pending[client] = self._pending.pop(client)  # to the end of the turns
                pending.is_coarse_due = False
                if is_fine:
                    pending.fine_at = None
                return RenderJob(client, pending.wanted, is_fine, pending.number)
            return None

    def _put(self, client: int, wanted: T, is_coarse_due: bool, fine_at: float) -> None:
        with self._changed:
            self._count += 1
            self._pending[client] = _Pending(wanted, self._count, is_coarse_due, fine_at)  # keeps the client's turn
            self._changed.notify_all()

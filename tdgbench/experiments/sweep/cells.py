"""The cells of a sweep, one per job: which of them have to run, and how long that will take."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Literal, NamedTuple

from pydantic import TypeAdapter

from tdgbench.bench.outcome import Outcome
from tdgbench.files import write_text

FILE = "cells.json"
State = Literal["to run", "with a result", "without data"]


@dataclass(frozen=True)
class PlannedCell:
    """A cell before the sweep.

    kind: what it shares with the cells of other scenes and seeds: method, init, number of iterations and so on.
    state: `with a result` if one is on disk; whether it is of these settings, data and code shows in the cell's turn.
    """

    kind: str
    scene: str
    state: State


class Estimate(NamedTuple):
    """Time that a sweep still takes, from its finished cells. unknown: kinds of which none has finished."""

    seconds: float
    cells: int
    unknown: tuple[str, ...]


_SCHEMA = TypeAdapter(list[PlannedCell])


def write_cells(folder: Path, cells: Sequence[PlannedCell]) -> None:
    """Write the cells of a sweep into its folder, for its jobs."""
    write_text(folder / FILE, json.dumps([asdict(cell) for cell in cells], indent=1) + "\n")


def read_cells(folder: Path) -> list[PlannedCell]:
    """Return the cells of a sweep; none if its folder does not say."""
    try:
        return _SCHEMA.validate_json((folder / FILE).read_bytes())
    except (OSError, ValueError):
        return []


def count_by_state(cells: Sequence[PlannedCell]) -> str:
    """Return the number of cells by state, in words.

    >>> count_by_state([PlannedCell("tdg", "a", "to run"), PlannedCell("tdg", "b", "without data")])
    '2 cells: 1 to run, 0 with a result, 1 without data'
    """
    states: tuple[State, ...] = ("to run", "with a result", "without data")
    parts = [f"{sum(cell.state == state for cell in cells)} {state}" for state in states]
    return f"{len(cells)} {'cell' if len(cells) == 1 else 'cells'}: {', '.join(parts)}"


def pending(cells: Sequence[PlannedCell], outcomes: Mapping[int, Outcome]) -> list[PlannedCell]:
    """Return the cells without an outcome that will run. Results are outdated once one was run again.

    outcomes: by the number of the job.
    """
    outdated = any(cells[n].state == "with a result" and outcome.status == "ok" for n, outcome in outcomes.items())
    states = {"to run", "with a result"} if outdated else {"to run"}
    return [cell for number, cell in enumerate(cells) if number not in outcomes and cell.state in states]


def time_left(cells: Sequence[PlannedCell], outcomes: Mapping[int, Outcome], workers: int) -> Estimate | None:
    """Return the time until the pending cells are done, each as long as the finished ones that are most like it.

    Those are the cells of the same kind and scene, else of the same kind, else all. None before the first finished
    cell. workers: cells that run at once.
    """
    done = [(cells[n], outcome.seconds) for n, outcome in outcomes.items() if outcome.status == "ok"]
    if not done:
        return None
    times, unknown = [], []
    for cell in pending(cells, outcomes):
        of_kind = [(other, seconds) for other, seconds in done if other.kind == cell.kind]
        of_scene = [(other, seconds) for other, seconds in of_kind if other.scene == cell.scene]
        alike = [seconds for _, seconds in of_scene or of_kind or done]
        times.append(sum(alike) / len(alike))
        if not of_kind:
            unknown.append(cell.kind)
    longest = max(times, default=0.0)
    return Estimate(max(sum(times) / workers, longest), len(done), tuple(dict.fromkeys(unknown)))


def remaining_time(
    cells: Sequence[PlannedCell], outcomes: Mapping[int, Outcome], workers: int, now: datetime | None = None
) -> str:
    """Say how many cells are still to run, and when the sweep will be done; empty where that is unknown."""
    outcomes = {n: outcome for n, outcome in outcomes.items() if n in range(len(cells))}  # a single run has no number
    left, estimate = pending(cells, outcomes), time_left(cells, outcomes, workers)
    if not left or estimate is None:
        return ""
    now = now or datetime.now()
    end = now + timedelta(seconds=estimate.seconds)
    until = f"{end:%H:%M}" if end.date() == now.date() else f"{end:%Y-%m-%d %H:%M}"
    ground = f"from {estimate.cells} {'cell' if estimate.cells == 1 else 'cells'}"
    if estimate.unknown:
        ground += f", none of them {' or '.join(estimate.unknown)}"
    return f"{len(left)} of {len(cells)} cells to go, about {roughly(estimate.seconds)} left (until {until}), {ground}"


def roughly(seconds: float) -> str:
    """Return a time without seconds, as text.

    >>> roughly(11400), roughly(600), roughly(20)
    ('3:10 h', '10 min', '1 min')
    """
    minutes = max(1, round(seconds / 60))
    return f"{minutes // 60}:{minutes % 60:02} h" if minutes >= 60 else f"{minutes} min"

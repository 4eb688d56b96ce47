"""The outcome of a cell, and its line on the terminal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tdgbench.cells.record import Record, read_all
from tdgbench.scoring import METRICS
from tdgbench.text import duration

Status = Literal["ok", "kept", "failed", "missing", "no prior", "elsewhere"]
WORDS: dict[Status, str] = {
    "ok": "done",
    "kept": "already there",
    "failed": "failed",
    "missing": "without data",
    "no prior": "failed, it has no depth prior",
    "elsewhere": "running in another process",
}
COMPLETE: tuple[Status, ...] = ("ok", "kept")  # the cell has a result
SUCCESS: tuple[Status, ...] = (*COMPLETE, "elsewhere")  # nothing went wrong
ONCE = "compile"  # phase that only the first cell of a machine spends time in


@dataclass(frozen=True)
class Outcome:
    """Outcome of a cell.

    status: `ok` (it ran), `kept` (its result was there), `failed`, `missing` (its scene is not on disk), `no prior` (it
    failed because its depth prior is not available), or `elsewhere` (another process runs it). scores, seconds: in
    words, and how long such a cell takes; of `ok` alone.
    """

    status: Status
    title: str
    message: str = ""
    scores: str = ""
    seconds: float = 0.0

    @property
    def line(self) -> str:
        """The outcome in one line.

        >>> Outcome("ok", "tdg on a", "resumed after iteration 9", "PSNR 24.06 dB").line
        'tdg on a: done, PSNR 24.06 dB (resumed after iteration 9)'
        >>> Outcome("failed", "tdg on a", "train: no memory").line
        'tdg on a: failed (train: no memory)'
        """
        scores = f", {self.scores}" if self.scores else ""
        first = self.message.partition("\n")[0]
        remark = f" ({first})" if first and self.status in ("ok", "failed") else ""
        return f"{self.title}: {WORDS[self.status]}{scores}{remark}"


def finished(record: Record, message: str) -> Outcome:
    """Return the outcome of a cell that ran."""
    seconds = sum(time for phase, time in record.seconds.items() if phase != ONCE)
    return Outcome("ok", record.title, message, scores_in_words(record), seconds)


def finished_records(experiment: Path, outcomes: Iterable[Outcome]) -> list[Record]:
    """Return the results of these cells in an experiment's folder, which may hold those of earlier runs, too."""
    titles = {outcome.title for outcome in outcomes if outcome.status in COMPLETE}
    return [record for record in read_all(experiment) if record.failure is None and record.title in titles]


def scores_in_words(record: Record) -> str:
    """Return the published scores of a finished cell, and its training time, or who made it elsewhere.

    >>> scores_in_words(Record("tdg", "", "a", "", 0, "", "", scores={"psnr": 24.061}, seconds={"train": 754.0}))
    'PSNR 24.06 dB, SSIM n/a, LPIPS n/a, trained in 0:12:34'
    """
    parts = [f"{m.label} {m.as_text(record.scores.get(m.name))}" for m in METRICS.values() if m.in_main_table]
    made = record.made_elsewhere
    return ", ".join([*parts, made["summary"] if made else f"trained in {duration(record.seconds['train'])}"])

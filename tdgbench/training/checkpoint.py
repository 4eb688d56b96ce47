"""Checkpoints: everything that changes during a training, in one file, to resume it after the process was killed."""

from __future__ import annotations

import glob
import hashlib
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import torch

from tdgbench.files import opened, whole_file
from tdgbench.tensors import load_tensors
from tdgbench.training.loop import LogLine, TrainingLog
from tdgbench.training.part import State
from tdgbench.training.trainer import Trainer

MAX_SHARE = 0.02  # of the time that writing takes
READ_BYTES = 2**20  # at once
DIGEST_BYTES = 32  # SHA-256 of torch's file, written behind it


@dataclass
class Checkpoint:
    """File with the state of one training, written at intervals and loaded when the training is resumed.

    Writing does not affect training: a resumed run ends with the bytes of an uninterrupted one.
    """

    path: Path
    made_with: State  # what the state depends on; a file made with anything else is not used
    seconds: float | None  # of training between two writes, 0 or more; longer where writing takes long; None: never
    notes: list[str] = field(default_factory=list)  # files that were not used or could not be written, with the reason
    _next: float = 0.0

    def __post_init__(self) -> None:
        if self.seconds is not None and self.seconds < 0:
            raise ValueError(f"checkpoint is {self.seconds}; it must be 0 or more seconds of training, or null")

    def resume(self, trainer: Trainer) -> TrainingLog:
        """Load the stored state into a new trainer; return the log so far, or an empty one.

        A file that is not whole, or that another training wrote, is not used, and `notes` says so.
        """
        self._trainer = trainer
        for partial in self.path.parent.glob(f".{glob.escape(self.path.stem)}.*{self.path.suffix}"):
            with suppress(OSError):
                partial.unlink()  # of a process that was killed while it wrote
        log = TrainingLog()
        if os.path.lexists(self.path):
            try:
                log = self._load(self._read())
            except Exception as error:  # parts may raise anything
                self.notes.append(f"a checkpoint was not used: {error or type(error).__name__}")
                trainer.restart()
        self._next = log.seconds + (self.seconds or 0.0)
        return log

    def write_if_due(self, log: TrainingLog) -> None:
        """Write the state if the last write was long enough ago; a failure becomes a note."""
        if self.seconds is None or log.seconds < self._next:
            return
        start = time.perf_counter()
        try:
            self._write(log)
        except (OSError, RuntimeError) as error:  # torch turns the former into the latter
            self.notes.append(f"no checkpoint at iteration {log.iterations} in {self.path.parent}: {error}")
        took = time.perf_counter() - start
        self._next = log.seconds + max(self.seconds, took / MAX_SHARE)

    def discard(self) -> None:
        """Remove the file. Raises OSError if that is not possible."""
        self.path.unlink(missing_ok=True)

    def _write(self, log: TrainingLog) -> None:
        content = {"made_with": self.made_with, "log": asdict(log), **self._trainer.state_dict()}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self.path) as part, part.open("wb") as file:
            torch.save(content, file)
            file.flush()
            file.write(_digest(part, file.tell()))

    def _read(self) -> State:
        """Return the stored content. Raises ValueError if the file is not whole or is of another training."""
        if not _ends_with_digest(self.path):
            raise ValueError("it is damaged")
        saved: State = load_tensors(self.path, mapped=True)
        before, at = saved["made_with"], saved["log"]["iterations"]
        differs = [k for k in sorted({*before, *self.made_with}) if before.get(k) != self.made_with.get(k)]
        if differs:
            raise ValueError(f"other {', '.join(differs)} (iteration {at})")
        return saved

    def _load(self, saved: State) -> TrainingLog:
        """Load the stored content, which the same code wrote in a training of the same options and data."""
        self._trainer.at_stage(saved["stage"])
        self._trainer.load_state_dict(saved)
        log = TrainingLog(**saved["log"])
        log.lines = [LogLine(**line) for line in saved["log"]["lines"]]
        log.resumed.append(log.iterations)
        return log


def _digest(path: Path, size: int) -> bytes:
    """Return the SHA-256 of the first bytes of a file."""
    digest = hashlib.sha256()
    with opened(path) as file:  # a mapping would count as memory of the process
        for start in range(0, size, READ_BYTES):
            digest.update(file.read(min(READ_BYTES, size - start)))
    return digest.digest()


def _ends_with_digest(path: Path) -> bool:
    """Return whether the last bytes of a file are the digest of all before them."""
    with opened(path) as file:
        size = file.seek(0, os.SEEK_END) - DIGEST_BYTES
        if size <= 0:
            return False
        file.seek(size)
        return file.read() == _digest(path, size)

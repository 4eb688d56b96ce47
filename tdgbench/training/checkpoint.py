"""Checkpoints: everything that changes during a training, in one file, to resume it after the process was killed."""

from __future__ import annotations

import glob
import hashlib
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any, cast

import torch
from torch import Tensor

from tdgbench.files import whole_file
from tdgbench.training.loop import LogLine, TrainingLog
from tdgbench.training.trainer import Trainer

MAX_SHARE = 0.02  # of the time that writing takes
DIGEST = "sha256"  # of the file of torch, behind which it is written
CHUNK = 2**20  # bytes read at once
PER_GAUSSIAN = ("rows", "density")  # parts of a model's state with one row per Gaussian


@dataclass
class Checkpoint:
    """File with the state of one training, written at intervals and loaded when the training is resumed.

    Writing does not affect training: a resumed run ends with the bytes of an uninterrupted one. What changes during
    training is in parts, which a method makes through its context.
    """

    path: Path
    made_with: dict[str, Any]  # what the state depends on; a file made with anything else is not used
    seconds: float | None  # of training between two writes, 0 or more; longer where writing takes long; None: never
    notes: list[str] = field(default_factory=list)  # files that were not used or could not be written, with the reason
    _next: float = 0.0

    def __post_init__(self) -> None:
        if self.seconds is not None and self.seconds < 0:
            raise ValueError(f"checkpoint is {self.seconds}; it must be 0 or more seconds of training, or null")

    def take_up(self, trainer: Trainer) -> TrainingLog:
        """Load the stored state into a trainer that was just made; returns the log so far, or an empty one.

        A file that is not whole, or that holds another state than this method has, is not used; nothing is loaded then.
        """
        self._trainer = trainer
        for partial in self.path.parent.glob(f".{glob.escape(self.path.stem)}.*{self.path.suffix}"):
            with suppress(OSError):
                partial.unlink()  # of a process that was killed while it wrote
        log = TrainingLog()
        if os.path.lexists(self.path):
            try:
                log = self._load(self._read())
            except Exception as error:  # torch documents no exception types for foreign files
                self.notes.append(f"a checkpoint was not used: {error or type(error).__name__}")
                trainer.restart()
        self._next = log.seconds + (self.seconds or 0.0)
        return log

    def after_step(self, log: TrainingLog) -> None:
        """Write the state if a write is due."""
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
        content = {"made_with": self.made_with, **_progress(log), **self._trainer.state_dict()}
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self.path) as part, part.open("wb") as file:
            hashing = _HashingFile(file)
            torch.save(content, cast(IO[bytes], hashing))
            file.write(hashing.digest.digest())

    def _read(self) -> dict[str, Any]:
        """Return the stored content. Raises ValueError if it is not whole or not of this training."""
        if not self.path.is_file():
            raise ValueError(f"{self.path} is not a file")
        _check_digest(self.path)
        saved: dict[str, Any] = torch.load(self.path, weights_only=True, mmap=True, map_location="cpu")
        before, at = saved["made_with"], saved["iterations"]
        differs = [k for k in sorted({*before, *self.made_with}) if before.get(k) != self.made_with.get(k)]
        if differs:
            raise ValueError(f"other {', '.join(differs)} (iteration {at})")
        self._trainer.at_stage(saved["stage"])
        wanted = {"made_with": self.made_with, **_progress(TrainingLog()), **self._trainer.state_dict()}
        problem = _mismatch(saved, wanted, "", is_exact=True)
        if problem is not None:
            raise ValueError(f"its {problem} does not fit this training")
        return saved

    def _load(self, saved: dict[str, Any]) -> TrainingLog:
        """Load the stored content."""
        lines = [LogLine(**line) for line in saved["lines"]]
        self._trainer.load_state_dict(saved)
        at = saved["iterations"]
        resumed = [*saved["resumed"], at]
        return TrainingLog(lines, saved["seconds"], saved["processor_seconds"], at, saved["ended"], resumed)


class _HashingFile:
    """File to write to that hashes what is written."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self.digest = file, hashlib.new(DIGEST)

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        return self._file.write(data)

    def flush(self) -> None:
        self._file.flush()


def _check_digest(path: Path) -> None:
    """Raise ValueError unless a file ends with the digest of all before it."""
    digest = hashlib.new(DIGEST)
    with path.open("rb") as file:
        remaining = os.fstat(file.fileno()).st_size - digest.digest_size
        while remaining > 0 and (chunk := file.read(min(CHUNK, remaining))):
            digest.update(chunk)
            remaining -= len(chunk)
        if remaining != 0 or file.read() != digest.digest():
            raise ValueError("it is damaged")


def _progress(log: TrainingLog) -> dict[str, Any]:
    """Return the log of a training as plain data."""
    return {
        "iterations": log.iterations,
        "seconds": log.seconds,
        "processor_seconds": log.processor_seconds,
        "ended": log.ended,
        "resumed": log.resumed,
        "lines": [asdict(line) for line in log.lines],
    }


def _mismatch(saved: Any, wanted: Any, place: str, *, is_exact: bool) -> str | None:
    """Return the first place where a stored state has other names, types, shapes or infinite numbers; None if it fits.

    is_exact: tensors must have the same number of rows; else the parts of a model must have equal numbers.
    """
    if isinstance(wanted, Tensor):
        fits = isinstance(saved, Tensor) and saved.dtype == wanted.dtype and saved.ndim == wanted.ndim
        fits = fits and saved.shape[not is_exact :] == wanted.shape[not is_exact :]
        return None if fits and torch.isfinite(saved.sum(dtype=torch.float64)) else place
    if type(saved) is not type(wanted):
        return place
    if isinstance(wanted, dict):
        wanted = wanted or saved  # filled in training, as the state of torch's optimisers is
        if saved.keys() != wanted.keys():
            return place or "content"
        parts = [(name, saved[name], wanted[name]) for name in wanted]
    elif isinstance(wanted, list) and wanted and not isinstance(wanted[0], int):
        if len(saved) != len(wanted):
            return place
        parts = [(number, *pair) for number, pair in enumerate(zip(saved, wanted, strict=True))]
    else:
        return None
    for name, part, like in parts:
        problem = _mismatch(part, like, f"{place}.{name}".lstrip("."), is_exact=is_exact and name not in PER_GAUSSIAN)
        if problem is not None:
            return problem
    if isinstance(wanted, dict) and wanted.keys() >= set(PER_GAUSSIAN):
        counts = {len(t) for part in PER_GAUSSIAN for t in saved[part].values() if isinstance(t, Tensor)}
        return None if len(counts) == 1 and min(counts) > 0 else f"{place}.rows"
    return None

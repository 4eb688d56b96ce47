"""Checkpoints: everything that changes during a training, in one file, to resume it after the process was killed."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch

from tdgbench.files import whole_file
from tdgbench.training.loop import LogLine, TrainingLog
from tdgbench.training.method import Context, Method
from tdgbench.training.skips.plateau import Plateau

MAX_SHARE = 0.02  # of the time that writing takes


@dataclass
class Checkpoint:
    """File with the state of one training, written at intervals and loaded when the training is resumed.

    Writing does not affect training: a resumed run ends with the bytes of an uninterrupted one. What changes during
    training is in models, random streams and view orders, all of which a method gets from its Context.
    """

    path: Path
    made_with: dict[str, Any]  # what the state depends on; a file made with anything else is not used
    seconds: float | None  # of training between two writes, 0 or more; longer where writing takes long; None: never
    notes: list[str] = field(default_factory=list)  # files that were not used or could not be written, with the reason
    _next: float = 0.0

    def __post_init__(self) -> None:
        if self.seconds is not None and self.seconds < 0:
            raise ValueError(f"checkpoint is {self.seconds}; it must be 0 or more seconds of training, or null")

    def take_up(self, method: Method, context: Context, plateau: Plateau | None) -> TrainingLog:
        """Load the stored state into a method that was just set up; returns the log so far, or an empty one."""
        self._method, self._context, self._plateau = method, context, plateau
        for partial in self.path.parent.glob(f".{self.path.stem}.*{self.path.suffix}"):
            partial.unlink()  # of a process that was killed while it wrote
        log = TrainingLog()
        saved = self._read()
        if saved is not None:
            context.load_state_dict(saved["context"])
            for name, model in method.models().items():
                model.load_state_dict(saved["models"][name])
            if plateau is not None:
                plateau.load_state_dict(saved["plateau"])
            lines = [LogLine(**line) for line in saved["lines"]]
            at = saved["iterations"]
            log = TrainingLog(lines, saved["seconds"], at, saved["ended"], [*saved["resumed"], at])
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
        """Remove the file."""
        self.path.unlink(missing_ok=True)

    def _write(self, log: TrainingLog) -> None:
        content = {
            "made_with": self.made_with,
            "iterations": log.iterations,
            "seconds": log.seconds,
            "ended": log.ended,
            "resumed": log.resumed,
            "lines": [asdict(line) for line in log.lines],
            "context": self._context.state_dict(),
            "models": {name: model.state_dict() for name, model in self._method.models().items()},
            "plateau": None if self._plateau is None else self._plateau.state_dict(),
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(self.path) as part:
            torch.save(content, part)

    def _read(self) -> dict[str, Any] | None:
        """The stored state, or None if there is none of this training."""
        if not self.path.exists():
            return None
        try:
            saved: dict[str, Any] = torch.load(self.path, weights_only=True, mmap=True, map_location="cpu")
            before, at = saved["made_with"], saved["iterations"]
        except Exception as error:  # torch documents no exception types for foreign files
            self.notes.append(f"a checkpoint was not used: {type(error).__name__}: {error}")
            return None
        differs = [k for k in sorted({*before, *self.made_with}) if before.get(k) != self.made_with.get(k)]
        if differs:
            self.notes.append(f"a checkpoint of iteration {at} was not used: other {', '.join(differs)}")
            return None
        return saved

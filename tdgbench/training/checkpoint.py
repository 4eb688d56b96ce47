"""What a killed training goes on from: everything that changes while it runs, in one file."""

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

MOST_OF_THE_TIME = 0.02  # share of the time that goes into writing


@dataclass
class Checkpoint:
    """Writes the state of one training to a file now and then, and takes it up again.

    Writing changes nothing in what training does next, so a run that went on from a file ends with the bytes of one
    that was never stopped. What changes during training lies in models, random streams and view orders, all of which
    a method has from its Context.
    """

    path: Path
    made_with: dict[str, Any]  # what the state depends on; a file that was made with anything else is not used
    seconds: float | None  # of training between two writes, 0 or more; longer where writing takes long; None: never
    notes: list[str] = field(default_factory=list)  # files that were not used or could not be written, and why
    _next: float = 0.0

    def __post_init__(self) -> None:
        if self.seconds is not None and self.seconds < 0:
            raise ValueError(f"checkpoint is {self.seconds}; it must be 0 or more seconds of training, or null")

    def take_up(self, method: Method, context: Context, plateau: Plateau | None) -> TrainingLog:
        """Put the stored state into a method that has just been set up; the log so far, empty if there is none."""
        self._method, self._context, self._plateau = method, context, plateau
        for left in self.path.parent.glob(f".{self.path.stem}.*{self.path.suffix}"):
            left.unlink()  # a process was killed while it wrote
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
        """Write the state if it is time."""
        if self.seconds is None or log.seconds < self._next:
            return
        start = time.perf_counter()
        try:
            self._write(log)
        except (OSError, RuntimeError) as error:  # torch's writer makes the latter of the former
            self.notes.append(f"no checkpoint at iteration {log.iterations} in {self.path.parent}: {error}")
        took = time.perf_counter() - start
        self._next = log.seconds + max(self.seconds, took / MOST_OF_THE_TIME)

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
        """The stored state, if there is one that was made as this training is."""
        if not self.path.exists():
            return None
        try:
            saved: dict[str, Any] = torch.load(self.path, weights_only=True, mmap=True, map_location="cpu")
            before, at = saved["made_with"], saved["iterations"]
        except Exception as error:  # torch names no types for a file that is none of its own
            self.notes.append(f"a checkpoint was not used: {type(error).__name__}: {error}")
            return None
        differs = [k for k in sorted({*before, *self.made_with}) if before.get(k) != self.made_with.get(k)]
        if differs:
            self.notes.append(f"a checkpoint of iteration {at} was not used: other {', '.join(differs)}")
            return None
        return saved

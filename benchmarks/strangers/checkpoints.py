"""Read a checkpoint as the viewer does, and as a training that resumes: `module:function` of a server's command."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, cast

from tdgbench.cells.cameras import read_cameras
from tdgbench.cells.record import read_record
from tdgbench.cells.renders import MethodInTraining
from tdgbench.terminal import say
from tdgbench.text import one_line
from tdgbench.training.checkpoint import Checkpoint


def read_checkpoint(words: list[str]) -> int:
    """Read a file with the record and cameras in a folder, then with the digest that checkpoints end with."""
    path, cell = map(Path, words)
    record = read_record(cell)
    assert record is not None
    try:
        MethodInTraining(path, record, read_cameras(cell))
    except ValueError as error:
        say(one_line(str(error)))
    path.write_bytes(path.read_bytes() + hashlib.sha256(path.read_bytes()).digest())
    checkpoint = Checkpoint(path, {}, None)
    checkpoint.resume(cast(Any, _Restarted()))
    say(one_line("; ".join(checkpoint.notes)))
    return 0


class _Restarted:
    """A trainer that loads nothing."""

    def restart(self) -> None:
        """Begin anew."""

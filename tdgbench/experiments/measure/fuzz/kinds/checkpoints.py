"""Checkpoints of an interrupted training: it ends with the bytes of an undisturbed one, whatever the file holds."""

from __future__ import annotations

import io
import random
import shutil
from pathlib import Path
from typing import Any

import torch

from tdgbench.experiments.measure.fuzz import cells
from tdgbench.experiments.measure.fuzz.case import Change, Kind, Programs
from tdgbench.experiments.measure.fuzz.damage import damage
from tdgbench.experiments.measure.fuzz.results import RESUMED


class Checkpoints(Kind):
    """A checkpoint: damaged bytes, a well-formed file with other content."""

    name, share, needs_results = "checkpoints", 4, True

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        for sub in ("data", "out"):
            shutil.copytree(base / "resumed" / sub, folder / sub)
        (self.file,) = (folder / "out" / "single" / "checkpoints").glob("*.pt")

    def mutate(self, rng: random.Random) -> Change:
        names = (self.file.name, "checkpoint")
        data = self.file.read_bytes()
        if rng.random() < 0.35:
            try:
                content = torch.load(io.BytesIO(data), weights_only=True)
            except Exception:  # an earlier mutation broke it
                content = {}
            content, what = _other(content, rng)
            torch.save(content, self.file)
            return Change(f"checkpoint: {what}", names)
        data, what = damage(data, rng)
        self.file.write_bytes(data)
        return Change(f"checkpoint: {what}", names)

    def run(self, programs: Programs) -> int:
        return cells.command_and_verify(programs, RESUMED, "out/single")

    def wrong(self) -> str:
        """Other bytes than those of an undisturbed training, or something left over."""
        calm, now = self.base / "resumed" / "calm" / "single" / "cells", self.folder / "out" / "single" / "cells"
        for path in sorted(calm.rglob("*")):
            other = now / path.relative_to(calm)
            if path.suffix in (".ply", ".png") and (not other.is_file() or other.read_bytes() != path.read_bytes()):
                return f"{path.name} has other bytes than without an interruption"
        return cells.unverified(self.folder)

    def lost(self) -> str:
        """A training never fails because of its checkpoint."""
        done = [one for one in cells.records(self.folder / "out" / "single") if one.get("status") == "ok"]
        return "" if done else "the training did not end with a result"


def _other(content: Any, rng: random.Random) -> tuple[Any, str]:
    """The content with another value at a random place."""
    place, trail = content, []
    while isinstance(place, dict) and place:
        key = rng.choice(sorted(place, key=str))
        trail.append(str(key))
        if not isinstance(place[key], dict) or not place[key] or rng.random() < 0.15:
            old = place[key]
            if isinstance(old, torch.Tensor) and old.numel() and rng.random() < 0.7:
                place[key] = rng.choice((_noisy, _shorter, _halved))(old)
            else:
                place[key] = rng.choice((None, -1, 10**9, "x", [], {}, torch.zeros(3)))
            return content, f"other {'.'.join(trail)}"
        place = place[key]
    return rng.choice(([], {}, None, torch.zeros(2))), "other content"


def _noisy(tensor: torch.Tensor) -> torch.Tensor:
    changed = tensor.clone()
    changed.view(-1)[0] += 1
    return changed


def _shorter(tensor: torch.Tensor) -> torch.Tensor:
    return tensor[:-1].clone() if tensor.ndim else tensor.reshape(1)


def _halved(tensor: torch.Tensor) -> torch.Tensor:
    return tensor.double()

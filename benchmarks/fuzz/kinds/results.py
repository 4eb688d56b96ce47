"""Finished results that were tampered with, a damaged plan, and checkpoints of an interrupted training."""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import random
import shutil
from pathlib import Path
from typing import Any

import torch

from benchmarks.fuzz import cells
from benchmarks.fuzz.case import Change, Kind, Programs
from benchmarks.fuzz.inputs import GOOD, SCENE
from benchmarks.fuzz.mutations import EXTREMES, damage, edit
from tdgbench.terminal import say

SAID = "verify.txt"
RESULTS = ("hashes", "method", "dataset", "scene", "init", "seed", "scores", "status", "views")  # fields of a record


class Records(Kind):
    """Files of a finished cell: other bytes, other values, missing and unknown files."""

    name, share, needs_results = "records", 12, True

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        shutil.copytree(base / "sweep" / "out", folder / "out")
        self.experiment = folder / "out" / "single"
        self.cell = next(path for path in (self.experiment / "cells").rglob("seed0") if path.parts[-3] == SCENE)
        self.original = base / "sweep" / "out" / "single" / self.cell.relative_to(self.experiment)

    def mutate(self, rng: random.Random) -> Change:
        files = sorted(path for path in self.cell.rglob("*") if path.is_file())
        how, path = rng.random(), rng.choice(files) if files else self.cell / "record.json"
        record = self.cell / "record.json"
        if how < 0.4 and record.exists():
            return self._change_record(record, rng)
        name = path.relative_to(self.cell).as_posix()
        names = (name, path.name)
        if how < 0.48:
            path.unlink(missing_ok=True)
            return Change(f"{name}: deleted", names)
        if how < 0.55:
            other = path.with_name(f"new{rng.randrange(9)}{path.suffix}")
            shutil.copy(path, other) if path.exists() else other.touch()
            return Change(f"{other.name}: added", (*names, other.name))
        if how < 0.6 and len(files) > 1:
            shutil.copy(rng.choice([one for one in files if one != path]), path)
            return Change(f"{name}: content of another file", names)
        old = path.read_bytes() if path.exists() else b""
        data, what = edit(old.decode(), rng) if _is_text(path) and rng.random() < 0.7 else damage(old, rng)
        path.write_bytes(data)
        return Change(f"{name}: {what}", names)

    def _change_record(self, path: Path, rng: random.Random) -> Change:
        """Another value of one field of the record, at any depth."""
        try:
            content = json.loads(path.read_bytes())
        except ValueError:
            content = {}
        place: Any = content if isinstance(content, dict) and content else {"x": 0}
        content, trail = place, []
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            key = rng.choice(keys)
            trail.append(str(key))
            if not isinstance(place[key], dict | list) or not place[key] or rng.random() < 0.25:
                break
            place = place[key]
        value: Any = rng.choice((None, True, "x", "", -1, 99, 1e308, [], {}, "[red]x", "../../x", 2**70, EXTREMES[-1]))
        if rng.random() < 0.2:
            del place[key]
            what = "deleted"
        else:
            place[key] = value
            what = f"is {value!r}"
        path.write_text(json.dumps(content, indent=1), encoding="utf-8")
        return Change(f"record.json: {'.'.join(trail)} {what}", ("record.json", "in the record", *trail))

    def run(self, programs: Programs) -> int:
        with Path(SAID).open("w", encoding="utf-8") as out, contextlib.redirect_stdout(out):
            verified = programs.verify(["out/single"])
        say(Path(SAID).read_text(encoding="utf-8"))
        return verified or cells.command(programs, ["tables", "out/single"])

    def lost(self) -> str:
        """The other cells, which nobody touched, stay in what verification says and in the tables."""
        with contextlib.suppress(FileNotFoundError):
            said = (self.folder / SAID).read_text(encoding="utf-8")
            if "out/single:" not in said:
                return "verification did not come to its end"
            if f"/{GOOD}/" in said:
                return "verification objects to a cell that nobody touched"
        return ""

    def wrong(self) -> str:
        """Status 0 says that everything is as it was, but for what cannot be recomputed."""
        for name in sorted({*_files(self.cell), *_files(self.original)} - {"record.json"}):
            if _digest(self.cell / name) != _digest(self.original / name):
                return f"0 problems, but {name} differs"
        try:
            before, after = (json.loads((one / "record.json").read_bytes()) for one in (self.original, self.cell))
        except (OSError, ValueError):
            return "0 problems, but record.json is missing or no JSON"
        differs = [name for name in RESULTS if name in before and after.get(name) != before[name]]
        if differs:
            return f"0 problems, but record.json has other {', '.join(differs)}"
        table = self.experiment / "tables" / "main.csv"
        with table.open(newline="", encoding="utf-8") as file:
            scenes = {row["scene"] for row in csv.DictReader(file)}
        return "" if {SCENE, GOOD} <= scenes else f"the tables lack cells: {sorted(scenes)}"


class Tables(Records):
    """The same tampering, and `tdgbench tables` whatever verification says: tables come, or one clear error."""

    name, share = "tables", 6

    def run(self, programs: Programs) -> int:
        return cells.command(programs, ["tables", "out/single"])

    def lost(self) -> str:
        return ""

    def wrong(self) -> str:
        table = self.experiment / "tables" / "main.csv"
        with table.open(newline="", encoding="utf-8") as file:
            scenes = {row["scene"] for row in csv.DictReader(file)}
        return "" if GOOD in scenes else f"the tables lack {GOOD}"


def _files(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _is_text(path: Path) -> bool:
    return path.suffix in (".json", ".csv")


class Plan(Kind):
    """A damaged plan: tables come, or one error names it."""

    name, share, needs_results = "plan", 3, True

    def __init__(self, base: Path, folder: Path, rng: random.Random) -> None:
        super().__init__(base, folder, rng)
        shutil.copytree(base / "sweep" / "out", folder / "out")
        self.file = folder / "out" / "single" / "experiment.json"

    def mutate(self, rng: random.Random) -> Change:
        data, how = self.file.read_bytes(), rng.random()
        if how < 0.3:
            data, what = damage(data, rng)
        elif how < 0.6:
            data, what = edit(data.decode(errors="replace"), rng)
        else:
            content = json.loads(
                (self.base / "sweep" / "out" / "single" / "experiment.json").read_text(encoding="utf-8")
            )
            name = rng.choice([*content, "unknown"])
            content[name] = rng.choice((None, 3, "x", [], [3], [{}], {}, ["<script>"], [{"scene": "x"}], [["x"]]))
            data, what = json.dumps(content).encode(), f"{name} is {content[name]!r}"
        self.file.write_bytes(data)
        return Change(f"experiment.json: {what}", ("experiment.json",))

    def run(self, programs: Programs) -> int:
        return cells.command(programs, ["tables", "out/single"])

    def wrong(self) -> str:
        return cells.outputs_lost(self.folder / "out" / "single", GOOD)


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
        return cells.command_and_verify(programs, cells.RESUMED, "out/single")

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

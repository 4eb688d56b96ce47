"""`experiment.json`: the plan of a sweep, from which tables are built."""

from __future__ import annotations

import json
import random
import shutil
from pathlib import Path

from tdgbench.experiments.measure.fuzz.case import Change, Kind, Programs
from tdgbench.experiments.measure.fuzz.cells import command, outputs_lost
from tdgbench.experiments.measure.fuzz.damage import damage, edit
from tdgbench.experiments.measure.fuzz.inputs import GOOD


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
        return command(programs, ["tables", "out/single"])

    def wrong(self) -> str:
        return outputs_lost(self.folder / "out" / "single", GOOD)

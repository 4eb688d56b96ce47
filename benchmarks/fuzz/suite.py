"""Draw cases by seed and number, run them side by side, shrink and keep those that break."""

from __future__ import annotations

import json
import random
import shutil
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import torch

from benchmarks.fuzz.case import ALLOWED, Change, Kind, Outcome, Programs, find_kinds, judge
from benchmarks.fuzz.cells import write_results
from benchmarks.fuzz.child import Child, Limits, Ran
from benchmarks.fuzz.inputs import write_inputs

POLL = 0.01  # seconds between two looks at the children


@dataclass(frozen=True)
class Drawn:
    """A case before it is made: which mutations its stack holds is decided by seed and number alone."""

    seed: int
    number: int
    kind: type[Kind]
    mutations: tuple[int, ...]  # positions in the stack; fewer after shrinking

    def rng(self, what: object) -> random.Random:
        """Random stream of one part of the case, so that parts can be left out."""
        return random.Random(f"{self.seed}/{self.number}/{self.kind.name}/{what}")


@dataclass(frozen=True)
class Finding:
    """What became of a case."""

    drawn: Drawn
    changes: list[Change]
    outcome: Outcome
    why: str
    ran: Ran

    @property
    def broke(self) -> bool:
        return self.outcome not in ALLOWED


def draw(seed: int, number: int) -> Drawn:
    """The case of a seed and a number.

    >>> draw(0, 7) == draw(0, 7), draw(0, 7) == draw(1, 7)
    (True, False)
    """
    rng, kinds = random.Random(f"{seed}/{number}"), list(find_kinds().values())
    (kind,) = rng.choices(kinds, [one.share for one in kinds])
    return Drawn(seed, number, kind, tuple(range(rng.choice((1, 1, 1, 1, 2, 3)))))


class Suite:
    """Cases in children, below a scratch folder that holds the good inputs.

    results: make good results, too, for the kinds that need them; cells then find every kernel loaded.
    """

    def __init__(self, programs: Programs, scratch: Path, limits: Limits | None = None, results: bool = True) -> None:
        self.programs, self.scratch, self.limits = programs, scratch, limits or Limits()
        self.base = scratch / "base"
        torch.set_num_threads(1)  # a forked child has no pool of threads
        write_inputs(self.base)
        if results:
            write_results(self.base, programs)

    def run(self, cases: Iterable[Drawn], jobs: int) -> Iterator[Finding]:
        """Findings of cases, in the order in which they end; `jobs` run at once."""
        waiting, running = iter(cases), list[tuple[Drawn, Kind, list[Change], Child]]()
        more = True
        while more or running:
            while more and len(running) < jobs:
                drawn = next(waiting, None)
                more = drawn is not None
                if drawn is not None:
                    running.append(self._start(drawn))
            for one in list(running):
                ran = one[3].poll()
                if ran is not None:
                    running.remove(one)
                    yield self._finding(*one[:3], ran)
                    shutil.rmtree(one[3].folder, ignore_errors=True)
            time.sleep(POLL)

    def confirm(self, finding: Finding) -> Finding:
        """The finding; one that took too long runs again, alone, since the machine may have been busy."""
        if finding.outcome != "hang":
            return finding
        (again,) = self.run([finding.drawn], 1)
        return again

    def shrink(self, finding: Finding, keep: Path) -> Finding:
        """The finding with the fewest mutations that break in the same way; its files go to `keep`."""
        best, number = finding, len(finding.drawn.mutations)
        for left_out in finding.drawn.mutations if number > 1 else ():
            fewer = tuple(m for m in best.drawn.mutations if m != left_out)
            (tried,) = self.run([_with(best.drawn, fewer)], 1) if fewer else (best,)
            best = tried if tried.outcome == finding.outcome else best
        folder = keep / f"{best.outcome}-{best.drawn.kind.name}-{best.drawn.seed}-{best.drawn.number}"
        shutil.rmtree(folder, ignore_errors=True)
        made = Path(tempfile.mkdtemp(dir=self.scratch))
        case, _ = self._make(best.drawn, made)
        self._keep(made, folder)
        shutil.rmtree(made, ignore_errors=True)
        content = {**_described(best), "words": case.words}
        (folder / "case.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        return best

    def _keep(self, made: Path, folder: Path) -> None:
        """Copy the files of a case that are neither good inputs nor a device."""
        good = {path.read_bytes() for path in self.base.rglob("*") if path.is_file()}
        folder.mkdir(parents=True)
        for path in made.rglob("*"):
            if path.is_file() and not path.is_symlink() and path.stat().st_size < 10**7:
                data = path.read_bytes()
                if data not in good:
                    (folder / path.relative_to(made)).parent.mkdir(parents=True, exist_ok=True)
                    (folder / path.relative_to(made)).write_bytes(data)

    def _start(self, drawn: Drawn) -> tuple[Drawn, Kind, list[Change], Child]:
        folder = Path(tempfile.mkdtemp(dir=self.scratch))
        case, changes = self._make(drawn, folder)
        return drawn, case, changes, Child(lambda: case.run(self.programs), folder, self.limits)

    def _make(self, drawn: Drawn, folder: Path) -> tuple[Kind, list[Change]]:
        """The input of a case, mutated, in an empty folder."""
        case = drawn.kind(self.base, folder, drawn.rng("input"))
        return case, [_mutated(case, drawn.rng(m), first=m == drawn.mutations[0]) for m in drawn.mutations]

    def _finding(self, drawn: Drawn, case: Kind, changes: list[Change], ran: Ran) -> Finding:
        try:
            outcome, why = judge(case, changes, ran)
        except Exception as error:  # no reader of the product wrote what the oracle cannot read
            outcome, why = "wrong", f"what was written cannot be read: {error!r}"
        return Finding(drawn, changes, outcome, why, ran)


def _mutated(case: Kind, rng: random.Random, first: bool) -> Change:
    """The next mutation; nothing where an earlier one left nothing to mutate, which readers report in many ways."""
    try:
        return case.mutate(rng)
    except Exception:
        if first:
            raise
        return Change("nothing", ())


def _with(drawn: Drawn, mutations: tuple[int, ...]) -> Drawn:
    return Drawn(drawn.seed, drawn.number, drawn.kind, mutations)


def _described(finding: Finding) -> dict[str, object]:
    drawn, ran = finding.drawn, finding.ran
    return {
        "again": f"python -m benchmarks.fuzz --seed {drawn.seed} --case {drawn.number}",
        "seed": drawn.seed,
        "case": drawn.number,
        "kind": drawn.kind.name,
        "mutations": [change.text for change in finding.changes],
        "outcome": finding.outcome,
        "why": finding.why,
        "seconds": round(ran.seconds, 1),
        "megabytes": round(ran.megabytes),
        "output": ran.output[-4000:],
    }

"""Run the parts one after the other within a time limit, and write what was found after each."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
import time
from argparse import Namespace
from collections import Counter
from pathlib import Path
from typing import Any

from tdgbench.bench.environment import describe_environment
from tdgbench.children import Ended, run_limited
from tdgbench.files import write_text

ROOT = Path(__file__).resolve().parents[2]
TESTS_SHARE = 0.35  # of all the time, that the tests marked `cuda` have at most, and again the whole suite
PART_SHARE = 0.5  # of the time that is left, so that one that hangs leaves some to the others
FEWEST_SECONDS = 10.0  # a part that has less does not begin
NO_BACKEND = "no backend has passed its check"
OUTCOMES = ("PASSED", "FAILED", "ERROR", "SKIPPED", "XFAIL")


class Measurement:
    """What was found so far; the file is whole after every part."""

    def __init__(self, args: Namespace) -> None:
        self.args, self.start = args, time.monotonic()
        self.file = args.out / "gpu.json"
        self.found: dict[str, Any] = {
            "environment": describe_environment(), "minutes": args.minutes, "scene": " ".join(args.scene),
            "overrides": args.overrides, "checks": {}, "tests": {}, "trainings": [], "profiles": {},
        }  # fmt: skip

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return self.start + 60 * self.args.minutes - time.monotonic()

    @property
    def has_no_backend(self) -> bool:
        """Whether backends were checked, and none passed."""
        checks = self.found["checks"].values()
        return bool(checks) and all(check["reason"] for check in checks)

    def run(self) -> dict[str, Any]:
        """Run all parts, the most important ones first."""
        self.args.out.mkdir(parents=True, exist_ok=True)
        for backend in self.args.backends:
            self._keep("checks", backend, self._part("check", PART_SHARE, backend=backend)[0])
        if self.args.tests:
            self._keep("tests", "marked cuda", self._tests(["-m", "cuda"]))
        cells = [(backend, method) for backend in self.args.backends for method in self.args.methods]
        for number, budget in enumerate(self.args.budgets):
            for position, (backend, method) in enumerate(cells):
                share = PART_SHARE if number == 0 else 1 / (len(cells) - position)
                self._train(backend, method, budget, share)
            if number == 0:
                for backend, method in cells:
                    overrides = self._overrides(backend, method, budget)
                    steps = self._unusable(backend) or self._part("profile", PART_SHARE, overrides=overrides)
                    self._keep("profiles", f"{backend}, {method}, {budget}", steps[0])
                if self.args.tests:
                    self._keep("tests", "whole suite", self._tests([]))
        self.found["seconds"] = round(time.monotonic() - self.start, 1)
        self._write()
        return self.found

    def _train(self, backend: str, method: str, budget: str, share: float) -> None:
        """Train a cell several times, in a share of the time that is left; add its row."""
        count, name = self.args.repetitions, f"{backend}-{method}-{budget}"
        given = {"results": str(self.args.out.resolve() / name), "repetitions": count, "seconds": share * self.left}
        overrides = self._overrides(backend, method, budget)
        runs = self._unusable(backend) or self._part("train", share, overrides=overrides, **given)
        runs += [{"n/a": runs[-1].get("n/a", "there was no time for it")}] * (count - len(runs))
        models = [json.dumps(run["model"], sort_keys=True) for run in runs if "model" in run]
        same = len(set(models)) == 1 if len(models) > 1 else None  # None: there is nothing to compare
        row = {"backend": backend, "method": method, "budget": budget, "equal_bytes": same, "runs": runs}
        self.found["trainings"].append(row)
        self._write()

    def _overrides(self, backend: str, method: str, budget: str) -> list[str]:
        common = ("metrics.lpips.download=false", *self.args.scene)  # PSNR is enough, and the machine may be offline
        return [f"method={method}", f"budget={budget}", f"backend={backend}", *common, *self.args.overrides]

    def _unusable(self, backend: str) -> list[dict[str, Any]]:
        """Return why a backend cannot be measured; empty if it can."""
        reason = self.found["checks"][backend]["reason"]
        return [{"n/a": f"{backend}: {reason}"}] if reason else []

    def _part(self, part: str, share: float, **given: Any) -> list[dict[str, Any]]:
        """Run a part in a process of its own. Returns what it found; last, why there is no more if it did not end."""
        if self.left < FEWEST_SECONDS:
            return [_without("there was no time for it")]
        command = [sys.executable, "-m", "benchmarks.gpu.parts", part, json.dumps(given)]
        ended = run_limited(command, share * self.left, ROOT)
        found = [json.loads(line) for line in ended.out.splitlines() if line.startswith("{")]
        return found if found and ended.status == 0 else [*found, _without(ended.why)]

    def _tests(self, options: list[str], where: str = "tests") -> dict[str, Any]:
        """Run the tests of a folder or file. Returns counts by outcome, those that failed, and how it ended."""
        if self.has_no_backend:
            return _without(NO_BACKEND)
        seconds = min(self.left, 60 * self.args.minutes * TESTS_SHARE)
        if seconds < FEWEST_SECONDS:
            return _without("there was no time for them")
        if importlib.util.find_spec("xdist") and not options:
            options = ["-n", "auto", "--dist", "loadfile"]
        command = [sys.executable, "-m", "pytest", "-vv", "-p", "no:cacheprovider", *options, where]
        command.append("--continue-on-collection-errors")  # a package that one file of tests lacks costs that file
        return counts_of(run_limited(command, seconds, ROOT))

    def _keep(self, kind: str, name: str, found: dict[str, Any]) -> None:
        self.found[kind][name] = found
        self._write()

    def _write(self) -> None:
        write_text(self.file, json.dumps(self.found, indent=1, default=str))


def _without(reason: str) -> dict[str, str]:
    """Return what stands for a missing result; `reason`: of a check, which is then not passed."""
    return {"n/a": reason, "reason": reason}


def counts_of(ended: Ended) -> dict[str, Any]:
    """Return counts of the tests that a verbose run of pytest has come to, and those that failed.

    >>> out = "tests/a.py::b PASSED [ 1%]\\n[gw0] [ 2%] FAILED tests/a.py::c\\ntests/a.py::d SKIPPED (no GPU)"
    >>> found = counts_of(Ended(None, out, ""))
    >>> found["passed"], found["skipped"], found["failed"], found["ended"]
    (1, 1, ['tests/a.py::c'], 'it did not end within its time limit')
    """
    outcome = "|".join(OUTCOMES)  # before the name where xdist or the summary writes it, else behind it
    before = re.findall(rf"^(?:\[gw\d+\].*?)?({outcome}) (tests/\S+?::.*?)(?: - .*| *)$", ended.out, re.MULTILINE)
    behind = re.findall(rf"^(tests/\S+?::.*?) ({outcome})\b.*$", ended.out, re.MULTILINE)
    outcomes = dict(behind) | {name: found for found, name in before}
    counts = Counter(outcomes.values())
    failed = sorted(name for name, found in outcomes.items() if found in ("FAILED", "ERROR"))
    ends = "whole" if ended.status in (0, 1, 5) else ended.why  # of pytest: passed, failed, nothing to run
    return {"passed": counts["PASSED"], "skipped": counts["SKIPPED"], "failed": failed, "ended": ends}

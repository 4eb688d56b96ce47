"""Run the command line, verify and read what it wrote; make the good results that some kinds begin with."""

from __future__ import annotations

import contextlib
import csv
import json
import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from hydra import version
from hydra.core.global_hydra import GlobalHydra
from hydra.core.singleton import Singleton

from benchmarks.fuzz.case import Programs
from benchmarks.fuzz.child import Child, Limits, Ran
from benchmarks.fuzz.inputs import CELL, GOOD, SCENE, copy_scene
from tdgbench.splats.cpu import pool
from tdgbench.training.checkpoint import Checkpoint

VERIFIED = "verified.json"


def command(programs: Programs, words: list[str]) -> int:
    """Exit status of `tdgbench` with these arguments, on the CPU: bytes are compared, which a GPU need not repeat."""
    sys.argv = ["tdgbench", *words]
    os.environ.update(TORCH_HOME="torch", COLUMNS="200", CUDA_VISIBLE_DEVICES="")
    GlobalHydra.instance().clear()
    version.setbase("1.3")  # as the program does when it is imported, which is once, and may be undone since
    try:
        return programs.tdgbench()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else 1


@contextlib.contextmanager
def as_a_process(folder: Path) -> Iterator[None]:
    """Run programs in this process, in a folder: what they change in the process is restored, their output is lost."""
    root, hydra = logging.getLogger(), Singleton.get_state()
    before = root.handlers[:], root.level, sys.argv, dict(os.environ)
    try:
        with (
            contextlib.chdir(folder),
            Path(os.devnull).open("w", encoding="utf-8") as nowhere,
            contextlib.redirect_stdout(nowhere),
            contextlib.redirect_stderr(nowhere),
        ):
            yield
    finally:
        root.handlers[:], root.level, sys.argv, environment = before
        os.environ.clear()
        os.environ.update(environment)
        pool.set_threads(None)
        Singleton.set_state(hydra)
        GlobalHydra.instance().clear()


def command_and_verify(programs: Programs, words: list[str], experiment: str) -> int:
    """Exit status of `tdgbench`; what `tdgbench verify` says of its results goes to VERIFIED."""
    status = command(programs, words)
    if Path(experiment, "cells").is_dir():
        with (
            Path("verify.txt").open("w", encoding="utf-8") as out,
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(out),
        ):
            verified = programs.verify(["--", experiment])  # whose name may begin with a dash
        Path(VERIFIED).write_text(
            json.dumps({"status": verified, "said": Path("verify.txt").read_text(encoding="utf-8")}), encoding="utf-8"
        )
    return status


def unverified(folder: Path) -> str:
    """What verification objects to; empty if it says 0 problems."""
    try:
        verified = json.loads((folder / VERIFIED).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return "nothing was written that could be verified"
    return "" if verified["status"] == 0 else f"verification: {verified['said'].strip()}"


def records(experiment: Path) -> list[dict[str, Any]]:
    """The records of an experiment that are JSON objects."""
    found = []
    for path in sorted((experiment / "cells").rglob("record.json")):
        with contextlib.suppress(OSError, ValueError):
            content = json.loads(path.read_text(encoding="utf-8"))
            if isinstance(content, dict) and not any(p.startswith(".") for p in path.relative_to(experiment).parts):
                found.append(content)
    return found


def outputs_lost(experiment: Path, scene: str) -> str:
    """Which of the outputs of a sweep is missing: the finished cell of a good scene, the table, the report."""
    if not any(one.get("scene") == scene and one.get("status") == "ok" for one in records(experiment)):
        return f"the cell of {scene} is not there"
    table, report = experiment / "tables" / "main.csv", experiment / "report.html"
    if not table.is_file() or not report.is_file():
        return "tables or report are not there"
    with table.open(newline="", encoding="utf-8") as file:
        scenes = {row["scene"] for row in csv.DictReader(file)}
    return "" if scene in scenes else f"the table lacks {scene}"


SWEEP = ["-m", *CELL, "method=3dgs", f"scene={SCENE},{GOOD},broken"]
RESUMED = [*CELL, "method=tdg", f"scene={SCENE}", "budget.iterations=8", "checkpoint=0"]
STOP_AT = 5  # iterations


def write_results(base: Path, programs: Programs) -> None:
    """Write base/sweep (its data and out/single) and base/resumed (data, calm/single, out/single with a checkpoint)."""
    sweep, resumed = base / "sweep", base / "resumed"
    for scene in (SCENE, GOOD):
        copy_scene(base, sweep / "data" / scene)
    shutil.copytree(sweep / "data" / GOOD, sweep / "data" / "broken")
    shutil.rmtree(sweep / "data" / "broken" / "sparse")
    copy_scene(base, resumed / "data" / SCENE)
    with as_a_process(sweep):  # here, so that children find every module imported and every kernel loaded
        command(programs, SWEEP)
        command(programs, [*CELL, "method=msmg", f"scene={GOOD}", "results=first"])
        programs.verify(["out/single"])
    _expect(0, wait(lambda: command(programs, RESUMED), resumed))
    (resumed / "out").rename(resumed / "calm")
    _expect(9, wait(lambda: _stopped(programs), resumed))


def wait(work: Callable[[], int], folder: Path, limits: Limits | None = None) -> Ran:
    """Run in a child and wait for its end."""
    child = Child(work, folder, limits or Limits(seconds=300))
    while (ran := child.poll()) is None:
        time.sleep(0.01)
    return ran


def _expect(status: int, ran: Ran) -> None:
    if ran.status != status:
        raise RuntimeError(f"a good input ends with status {ran.status}, not {status}:\n{ran.output[-3000:]}")


def _stopped(programs: Programs) -> int:
    """Train until a checkpoint of iteration STOP_AT is on disk; end as a killed process does."""
    write_if_due = Checkpoint.write_if_due

    def stop(self, log) -> None:
        write_if_due(self, log)
        if log.iterations == STOP_AT:
            os._exit(9)

    Checkpoint.write_if_due = stop  # type: ignore[method-assign]
    return command(programs, RESUMED)

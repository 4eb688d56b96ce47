"""Good results, made once per suite with the command line: a sweep with a failed cell, an interrupted training."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from tdgbench.experiments.measure.fuzz.case import Programs
from tdgbench.experiments.measure.fuzz.cells import as_a_process, command
from tdgbench.experiments.measure.fuzz.child import Child, Limits, Ran
from tdgbench.experiments.measure.fuzz.inputs import CELL, GOOD, SCENE, copy_scene
from tdgbench.training.checkpoint import Checkpoint

SWEEP = ["-m", *CELL, "method=splat", f"scene={SCENE},{GOOD},broken"]
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
    after_step = Checkpoint.after_step

    def stop(self, log) -> None:
        after_step(self, log)
        if log.iterations == STOP_AT:
            os._exit(9)

    Checkpoint.after_step = stop  # type: ignore[method-assign]
    return command(programs, RESUMED)

"""`python -m benchmarks.killed`: end a sweep at random moments, resume it, compare with an undisturbed one.

Signals end it, or a disk that is full from a random write on; finished sweeps are started anew until the kills are
made. Exit status 1 if something finished was lost or ran twice, if bytes differ in more than times, if SIGINT and
SIGTERM do not end with 130 and 143, or if something is left over.
"""

from __future__ import annotations

import argparse
import signal
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.killed.sweep import Plan, Sweep, kill_many

SMALL = (
    "-m", "method=3dgs,tdg", "scene=orbit,turntable", "dataset.loader.width=32", "dataset.loader.height=24",
    "dataset.loader.views=8", "dataset.loader.points=200", "prior=synthetic", "budget=demo", "budget.iterations=150",
    "metrics.lpips.download=false", "checkpoint=0.2", "data.root=data",
)  # fmt: skip


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.killed", description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="of the random moments")
    args = parser.parse_args()
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as with `&` in a shell; sweeps would inherit it
        signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as scratch:
        sweep, begin = Sweep(list(SMALL), "single", Path(scratch)), time.monotonic()
        calm = sweep.run_calm()
        print(f"undisturbed: {calm.seconds:.1f} s, {calm.writes} writes", flush=True)
        kills = kill_many(sweep, calm, Plan(args.kills, seed=args.seed), lambda kill: print(kill, flush=True))
    good = sum(not kill.problems for kill in kills)
    for problem in dict.fromkeys(f"{kill}: {problem}" for kill in kills for problem in kill.problems):
        print(f"problem: {problem}")
    promise = "nothing lost, nothing run twice, same bytes, no leftovers"
    print(f"{good} of {len(kills)} kills: {promise} ({time.monotonic() - begin:.0f} s)")
    return int(good < len(kills))


if __name__ == "__main__":
    sys.exit(main())

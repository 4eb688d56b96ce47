"""`python -m benchmarks.killed`: kill a sweep at random moments, resume it, compare with an undisturbed one.

The signal is SIGKILL. The sweep is the demo, or that of the given overrides. Exit status 1 if records, pictures or
models differ in more than times, or if a finished cell ran twice.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from tdgbench.bench.record import read_all
from tdgbench.experiments.measure.kills import compare, run_killed, start_sweep


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.killed", description=__doc__)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--pause", type=float, nargs=2, default=(5.0, 30.0), help="shortest and longest, seconds")
    parser.add_argument("--seed", type=int, default=0, help="of the random moments")
    parser.add_argument("--name", default="demo", help="name of the experiment's folder")
    parser.add_argument("sweep", nargs="*", default=["+experiment=demo", "checkpoint=2"], help="Hydra overrides")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        calm, killed = Path(scratch) / "calm", Path(scratch) / "killed"
        begin = time.perf_counter()
        if start_sweep(args.sweep, calm).wait() != 0:
            print(f"the undisturbed sweep fails:\n{(Path(scratch) / 'calm.log').read_text()[-2000:]}", file=sys.stderr)
            return 1
        print(f"undisturbed: {time.perf_counter() - begin:.0f} s, {len(read_all(calm / args.name))} cells")
        kills, problems = run_killed(args.sweep, killed / args.name, args.kills, tuple(args.pause), args.seed)
        problems += compare(calm / args.name, killed / args.name)
        resumed = {record.title: record.resumed for record in read_all(killed / args.name) if record.resumed}
    for kill in kills:
        print(f"killed after {kill.seconds:.1f} s: {kill.finished} cells done, {kill.checkpoints} checkpoints")
    for title, iterations in resumed.items():
        print(f"{title}: resumed after iteration {', '.join(map(str, iterations))}")
    for problem in problems:
        print(f"problem: {problem}")
    print(f"{len(problems)} problems" if problems else "same records, renders and models; no finished cell ran twice")
    return bool(problems)


if __name__ == "__main__":
    sys.exit(main())

"""`python -m benchmarks.compile`: compile or load time of the kernels, of a first process and of a second one.

Both take one training step for each channel count, with and without depth, with an empty cache folder for the first.
Imports do not count. Exits with 1 if the second process takes more than LIMIT of the first's time.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.utils import instantiate

from tdgbench.training.warmup import compile_kernels

ROOT = Path(__file__).resolve().parents[1]
LIMIT = 0.1


def seconds_here(channels: set[int]) -> float:
    """Seconds until every kernel of a training with these channel counts has run once, in this process."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        budget = instantiate(compose("config", overrides=["budget=demo"]).budget)
    start = time.perf_counter()
    compile_kernels(channels, budget, "cpu")
    return time.perf_counter() - start


def seconds_of_two(channels: list[int]) -> tuple[float, float]:
    """The same for two processes, one after the other, that share an empty cache folder."""
    command = [sys.executable, "-m", "benchmarks.compile", "--here", "--channels", *map(str, channels)]
    with tempfile.TemporaryDirectory() as folder:
        env = {**os.environ, "XDG_CACHE_HOME": folder}
        runs = [subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=True) for _ in "12"]
    first, second = (float(run.stdout.split()[-1]) for run in runs)
    return first, second


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compile", description=__doc__)
    parser.add_argument("--channels", type=int, nargs="+", default=[1, 3], help="colour channels of the renders")
    parser.add_argument("--here", action="store_true", help="print the seconds of this process alone")
    args = parser.parse_args()
    if args.here:
        print(seconds_here(set(args.channels)))
        return
    first, second = seconds_of_two(args.channels)
    print(f"first process {first:.2f} s, second {second:.2f} s, ratio {second / first:.3f} (at most {LIMIT})")
    if second > LIMIT * first:
        sys.exit(1)


if __name__ == "__main__":
    main()

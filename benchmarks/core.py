"""`python -m benchmarks.core`: milliseconds of forward and backward passes of the splat core, which take turns.

On the CPU; `python -m benchmarks.gpu` measures the GPU backends.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import torch

from benchmarks.common.clouds import random_cloud
from benchmarks.common.timing import PARTS, interleave, median_ms, time_pass
from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.splats.cpu import pool

CHANNELS = {"1": (1, False), "3": (3, False), "1+depth": (1, True), "3+depth": (3, True)}


def measure(clouds: list[Cloud], channels: list[str], repetitions: int) -> pd.DataFrame:
    """One row per cloud, channels and part: size, gaussians, channels, part, ms. Those of a cloud take turns."""
    rows = []
    for cloud in clouds:
        runs: dict[tuple[str, str], Callable[[], float]] = {}
        for name in channels:
            count, depth = CHANNELS[name]
            seen = replace(cloud, colors=cloud.colors[:, :count])
            runs |= {(name, part): time_pass(seen, part, depth) for part in PARTS}
        for (name, part), seconds in interleave(runs, repetitions).items():
            size, ms = f"{cloud.width}x{cloud.height}", median_ms(seconds)
            rows.append({"size": size, "gaussians": len(cloud.means), "channels": name, "part": part, "ms": ms})
            print(f"{size:>8} {len(cloud.means):>8} {name:>8}  {part:<10}{ms:9.2f} ms", flush=True)
    return pd.DataFrame(rows)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.core", description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 100_000, 300_000])
    parser.add_argument("--sizes", nargs="+", default=["640x480", "320x240"])
    parser.add_argument("--channels", nargs="+", choices=CHANNELS, default=list(CHANNELS))
    parser.add_argument("--repetitions", type=int, default=11)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    pool.set_threads(args.threads)
    torch.set_num_threads(1)
    sizes = [tuple(int(n) for n in size.split("x")) for size in args.sizes]
    clouds = [random_cloud(count, width, height) for width, height in sizes for count in args.counts]
    table = measure(clouds, args.channels, args.repetitions)
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "core.csv", index=False)
    print(f"{pool.get_threads()} threads; written: {args.out}/core.csv")


if __name__ == "__main__":
    main()

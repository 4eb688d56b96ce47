"""`python -m benchmarks.core`: forward + backward of the splat core, in ms and ratios.

Where a CUDA GPU and gsplat are available, gsplat runs as well.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from benchmarks.common.clouds import random_cloud
from benchmarks.common.timing import interleave, median_ms, time_pass
from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.cpu import pool

VARIANTS = {"1": (1, False), "3": (3, False), "1+depth": (1, True), "3+depth": (3, True)}
MOST = "3+depth"  # that the others are compared with


def candidates_for(cloud: Cloud, variant: str) -> dict[str, Callable[[], float]]:
    channels, depth = VARIANTS[variant]
    cloud = replace(cloud, colors=cloud.colors[:, :channels])
    candidates = {
        "cpu": time_pass(cloud, "both", "cpu", depth=depth),
        "cpu forward": time_pass(cloud, "forward", "cpu", depth=depth),
        "cpu backward": time_pass(cloud, "backward", "cpu", depth=depth),
    }
    if "cuda" in fast_backends():
        candidates["gsplat"] = time_pass(cloud, "both", "cuda", depth=depth)
    return candidates


def measure(clouds: list[Cloud], variants: list[str], repetitions: int) -> pd.DataFrame:
    """One row per cloud, channels and candidate; those of a cloud take turns, and ratios are medians over the turns.

    cpu_ratio: time of `cpu` over that of the candidate. most_ratio: time of the candidate over that of the same one
    with 3 channels and depth.
    """
    rows = []
    for cloud in clouds:
        runs = {(v, c): run for v in variants for c, run in candidates_for(cloud, v).items()}
        seconds = {key: np.array(times) for key, times in interleave(runs, repetitions).items()}
        for (variant, candidate), times in seconds.items():
            ms, most = median_ms(times.tolist()), seconds.get((MOST, candidate))
            rows.append(
                {
                    "size": f"{cloud.width}x{cloud.height}", "gaussians": len(cloud.means),
                    "channels": variant, "candidate": candidate, "ms": ms,
                    "cpu_ratio": np.median(seconds[variant, "cpu"] / times),
                    "most_ratio": np.nan if most is None else np.median(times / most),
                }
            )  # fmt: skip
            print(_line(rows[-1]), flush=True)
    return pd.DataFrame(rows)


def _line(row: dict) -> str:
    most = "" if np.isnan(row["most_ratio"]) else f"  this/{MOST} {row['most_ratio']:5.2f}"
    return (
        f"{row['size']:>8} {row['gaussians']:>8} {row['channels']:>8}"
        f"  {row['candidate']:<13}"
        f"{row['ms']:9.2f} ms   cpu/this {row['cpu_ratio']:5.2f}{most}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.core", description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 100_000, 300_000])
    parser.add_argument("--sizes", nargs="+", default=["640x480", "320x240"])
    parser.add_argument("--channels", nargs="+", choices=VARIANTS, default=list(VARIANTS))
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

"""`python -m benchmarks.core`: forward + backward of the splat core, in ms, ratios, and share of the FMA peak.

Where a CUDA GPU and gsplat are available, gsplat runs as well.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from benchmarks.common.clouds import leaves_of, random_cloud, view_of
from benchmarks.common.timing import interleave, median_ms, time_pass
from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.jit import kernel
from tdgbench.splats.cpu.simd import reductions
from tdgbench.splats.cpu.simd import registers as simd

FORWARD_FLOPS, BACKWARD_FLOPS = 26, 47  # per pixel and Gaussian that has weight there
VARIANTS = {"1": (1, False), "3": (3, False), "1+depth": (1, True), "3+depth": (3, True)}
MOST = "3+depth"  # that the others are compared with
FMA_CHAINS, FMA_STEPS = 16, 1_000_000


def pairs_with_weight(cloud: Cloud) -> int:
    """Pixel-Gaussian pairs that a blend cannot skip, in registers of 8 or 16 pixels in which any has weight."""
    view = view_of(cloud, leaves_of(cloud, torch.float32), "cpu", depth=False)
    _, _, done, *_ = view.image.grad_fn.saved  # type: ignore[union-attr]
    starts, counts = done.tiles.starts, done.visits.counts
    active = [done.visits.active_blocks[start : start + n] for start, n in zip(starts, counts, strict=False)]
    return int(np.bitwise_count(np.concatenate(active)).sum()) * simd.LANES


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


@kernel()
def _fma_chains(steps, out):
    """Run sixteen independent chains, which hide the latency of two FMA units."""
    x = simd.broadcast(np.float32(0.999999))
    c = simd.broadcast(np.float32(1e-7))
    a0, a1, a2, a3, a4, a5, a6, a7 = c, c, c, c, c, c, c, c
    b0, b1, b2, b3, b4, b5, b6, b7 = c, c, c, c, c, c, c, c
    for _ in range(steps):
        a0 = a0 * x + c
        a1 = a1 * x + c
        a2 = a2 * x + c
        a3 = a3 * x + c
        a4 = a4 * x + c
        a5 = a5 * x + c
        a6 = a6 * x + c
        a7 = a7 * x + c
        b0 = b0 * x + c
        b1 = b1 * x + c
        b2 = b2 * x + c
        b3 = b3 * x + c
        b4 = b4 * x + c
        b5 = b5 * x + c
        b6 = b6 * x + c
        b7 = b7 * x + c
    total = a0 + a1 + a2 + a3 + (a4 + a5 + a6 + a7) + (b0 + b1 + b2 + b3) + (b4 + b5 + b6 + b7)
    out[0] = reductions.lane_sum(total)


def fma_peak_gflops() -> float:
    """Peak rate of fused multiply-adds on registers, all threads together, in GFLOP/s (two flops each)."""
    threads = pool.get_threads()
    outs = [np.zeros(1, np.float32) for _ in range(threads)]
    work = [(FMA_STEPS, out) for out in outs]
    seconds = []
    for _ in range(8):  # the first call compiles
        start = time.perf_counter()
        pool.run(_fma_chains, work)
        seconds.append(time.perf_counter() - start)
    best = min(seconds)
    return 2 * FMA_CHAINS * simd.LANES * FMA_STEPS * threads / best / 1e9


def measure(clouds: dict[str, Cloud], variants: list[str], repetitions: int) -> pd.DataFrame:
    """One row per cloud, channels and candidate; those of a cloud take turns, and ratios are medians over the turns.

    cpu_ratio: time of `cpu` over that of the candidate. most_ratio: time of the candidate over that of the same one
    with 3 channels and depth.
    """
    peak = fma_peak_gflops()
    rows = []
    for name, cloud in clouds.items():
        flops = pairs_with_weight(cloud) * (FORWARD_FLOPS + BACKWARD_FLOPS)
        runs = {(v, c): run for v in variants for c, run in candidates_for(cloud, v).items()}
        seconds = {key: np.array(times) for key, times in interleave(runs, repetitions).items()}
        for (variant, candidate), times in seconds.items():
            ms, most = median_ms(times.tolist()), seconds.get((MOST, candidate))
            rows.append(
                {
                    "cloud": name, "size": f"{cloud.width}x{cloud.height}", "gaussians": len(cloud.means),
                    "channels": variant, "candidate": candidate, "ms": ms,
                    "cpu_ratio": np.median(seconds[variant, "cpu"] / times),
                    "most_ratio": np.nan if most is None else np.median(times / most),
                    "peak_share": flops / (ms * 1e6) / peak if candidate == "cpu" else np.nan,
                }
            )  # fmt: skip
            print(_line(rows[-1]), flush=True)
    table = pd.DataFrame(rows)
    table.attrs["peak"] = peak
    return table


def _line(row: dict) -> str:
    most = "" if np.isnan(row["most_ratio"]) else f"  this/{MOST} {row['most_ratio']:5.2f}"
    share = "" if np.isnan(row["peak_share"]) else f"  {100 * row['peak_share']:4.1f} % of FMA peak"
    return (
        f"{row['cloud'].split()[0]:<8} {row['size']:>8} {row['gaussians']:>8} {row['channels']:>8}"
        f"  {row['candidate']:<13}"
        f"{row['ms']:9.2f} ms   cpu/this {row['cpu_ratio']:5.2f}{most}{share}"
    )


def draw(table: pd.DataFrame, path: Path) -> None:
    """Milliseconds against Gaussians, log-log, one line per candidate and channel count."""
    figure = Figure(figsize=(7, 4.5), layout="constrained")
    axis = figure.subplots()
    for (size, channels, name), line in table.groupby(["size", "channels", "candidate"], sort=False):
        if name not in ("cpu forward", "cpu backward"):
            axis.loglog(line["gaussians"], line["ms"], "o-", label=f"{name} {channels} {size}", lw=1)
    axis.set_xlabel("Gaussians")
    axis.set_ylabel("forward + backward, ms (median)")
    axis.legend(fontsize=7)
    axis.grid(True, which="both", alpha=0.3)
    figure.savefig(path, dpi=130)


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
    clouds = {}
    for size in args.sizes:
        width, height = (int(n) for n in size.split("x"))
        for count in args.counts:
            clouds[f"random {size} {count}"] = random_cloud(count, width, height)
    table = measure(clouds, args.channels, args.repetitions)
    table["cloud"] = table["cloud"].str.split().str[0]
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "core.csv", index=False)
    draw(table, args.out / "core.png")
    print(
        f"FMA peak {table.attrs['peak']:.0f} GFLOP/s, {pool.get_threads()} threads; written: {args.out}/core.csv, .png"
    )


if __name__ == "__main__":
    main()

"""`python -m benchmarks.core`: forward + backward of the splat core, in ms, ratios, and share of the FMA peak.

--torch                  also run plain torch, tile by tile (seconds per call)
--model PLY --data DIR   also render a trained model from a test camera of the capture in DIR
Where a CUDA GPU and gsplat are available, gsplat runs as well.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from tdgbench.experiments.measure import oracle
from tdgbench.experiments.measure.clouds import Cloud, random_cloud, trained_cloud
from tdgbench.experiments.measure.timing import fma_peak_gflops, interleave, median_ms
from tdgbench.splats.backends import fast_backends, load_backend
from tdgbench.splats.cpu import pool
from tdgbench.splats.cpu.simd.registers import LANES
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole

FORWARD_FLOPS, BACKWARD_FLOPS = 26, 47  # per pixel and Gaussian that has weight there
VARIANTS = {"1": (1, False), "3": (3, False), "1+depth": (1, True), "3+depth": (3, True)}
MOST = "3+depth"  # that the others are compared with


def ours(cloud: Cloud, channels: int, depth: bool, backend: str, part: str) -> Callable[[], float]:
    """Seconds of one forward pass, backward pass, or both, through autograd as training uses it."""
    device = torch.device(load_backend(backend).device)
    given = (cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.colors[:, :channels])
    leaves = [t.to(device).clone().requires_grad_() for t in given]
    size = (cloud.height, cloud.width)
    grads = [torch.ones(*size, channels, device=device), *([torch.ones(size, device=device)] if depth else [])]
    camera = Pinhole(cloud.viewmat.to(device), cloud.K.to(device), cloud.width, cloud.height)

    def now() -> float:
        if device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter()

    def run() -> float:
        start = now()
        rendered = render_view(GaussianTensors(*leaves), camera, depth=depth, backend=backend)
        middle = now()
        outputs = [rendered.image, *([rendered.depth] if rendered.depth is not None else [])]
        torch.autograd.backward(outputs, grads)
        end = now()
        for leaf in leaves:
            leaf.grad = None
        return {"forward": middle - start, "backward": end - middle, "both": end - start}[part]

    return run


def plain_torch(cloud: Cloud) -> Callable[[], float]:
    """Seconds of forward + backward in plain torch, float32, tile by tile, always with 3 channels and depth."""
    weights = torch.ones(cloud.height, cloud.width, 5)

    def run() -> float:
        start = time.perf_counter()
        oracle.render(cloud, torch.float32, weights)
        return time.perf_counter() - start

    return run


def pairs_with_weight(cloud: Cloud) -> int:
    """Pixel-Gaussian pairs that a blend cannot skip, in registers of 8 or 16 pixels in which any has weight."""
    given = (cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.colors[:, :1])
    leaves = [t.clone().requires_grad_() for t in given]
    camera = Pinhole(cloud.viewmat, cloud.K, cloud.width, cloud.height)
    view = render_view(GaussianTensors(*leaves), camera, backend="cpu")
    _, _, done, _ = view.image.grad_fn.saved  # type: ignore[union-attr]
    starts, counts = done.tiles.starts, done.visits.counts
    active = [done.visits.active_blocks[start : start + n] for start, n in zip(starts, counts, strict=False)]
    return int(np.bitwise_count(np.concatenate(active)).sum()) * LANES


def candidates_for(cloud: Cloud, variant: str, with_torch: bool) -> dict[str, Callable[[], float]]:
    channels, depth = VARIANTS[variant]
    candidates = {
        "cpu": ours(cloud, channels, depth, "cpu", "both"),
        "cpu forward": ours(cloud, channels, depth, "cpu", "forward"),
        "cpu backward": ours(cloud, channels, depth, "cpu", "backward"),
    }
    if "cuda" in fast_backends():
        candidates["gsplat"] = ours(cloud, channels, depth, "cuda", "both")
    if with_torch and variant == MOST:
        candidates["torch"] = plain_torch(cloud)
    return candidates


def measure(clouds: dict[str, Cloud], variants: list[str], repetitions: int, with_torch: bool) -> pd.DataFrame:
    """One row per cloud, channels and candidate; those of a cloud take turns, and ratios are medians over the turns.

    cpu_ratio: time of `cpu` over that of the candidate. most_ratio: time of the candidate over that of the same one
    with 3 channels and depth.
    """
    peak = fma_peak_gflops()
    rows = []
    for name, cloud in clouds.items():
        flops = pairs_with_weight(cloud) * (FORWARD_FLOPS + BACKWARD_FLOPS)
        runs = {(v, c): run for v in variants for c, run in candidates_for(cloud, v, with_torch).items()}
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
    parser.add_argument("--torch", action="store_true")
    parser.add_argument("--model", type=Path)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    if (args.model is None) != (args.data is None):
        parser.error("--model and --data go together")
    pool.set_threads(args.threads)
    torch.set_num_threads(1)
    clouds = {}
    for size in args.sizes:
        width, height = (int(n) for n in size.split("x"))
        for count in args.counts:
            clouds[f"random {size} {count}"] = random_cloud(count, width, height)
    if args.model is not None:
        clouds["trained"] = trained_cloud(args.model, args.data)
    table = measure(clouds, args.channels, args.repetitions, args.torch)
    table["cloud"] = table["cloud"].str.split().str[0]
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "core.csv", index=False)
    draw(table, args.out / "core.png")
    print(
        f"FMA peak {table.attrs['peak']:.0f} GFLOP/s, {pool.get_threads()} threads; written: {args.out}/core.csv, .png"
    )


if __name__ == "__main__":
    main()

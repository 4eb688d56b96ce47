"""`python -m benchmarks.core`: milliseconds of forward and backward passes of the splat core, which take turns.

On the CPU; `python -m benchmarks.gpu` measures the GPU backends.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeVar, get_args

import pandas as pd
import torch

from tdgbench.bench.backend_check.compare import NAMES, Cloud
from tdgbench.splats.cpu import pool
from tdgbench.splats.render import render_view
from tdgbench.splats.view import GaussianTensors, Pinhole

Key = TypeVar("Key")
Part = Literal["both", "forward", "backward"]
PARTS: tuple[Part, ...] = get_args(Part)
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


def random_cloud(count: int, width: int, height: int) -> Cloud:
    """Random Gaussians in a box 2 to 6 units away; at 640×480 most are a few pixels wide."""
    g = torch.Generator().manual_seed(0)
    means = torch.rand(count, 3, generator=g) * 2 - 1
    means[:, 2] = means[:, 2] * 2 + 4
    focal = 700 * width / 640
    return Cloud(
        means=means,
        quats=torch.randn(count, 4, generator=g),
        scales=torch.exp(torch.randn(count, 3, generator=g) * 0.4 - 4.2),
        opacities=torch.rand(count, generator=g) * 0.9 + 0.05,
        colors=torch.rand(count, 3, generator=g),
        viewmat=torch.eye(4),
        K=torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]]),
        width=width,
        height=height,
    )


def interleave(candidates: Mapping[Key, Callable[[], float]], repetitions: int) -> dict[Key, list[float]]:
    """Seconds of each candidate: call all once to warm up, then in turns; a candidate returns its seconds.

    A slow moment of the machine affects all of them.

    >>> interleave({"a": lambda: 1.0, "b": lambda: 2.0}, repetitions=2)
    {'a': [1.0, 1.0], 'b': [2.0, 2.0]}
    """
    for run in candidates.values():
        run()
    seconds: dict[Key, list[float]] = {name: [] for name in candidates}
    for _ in range(repetitions):
        for name, run in candidates.items():
            seconds[name].append(run())
    return seconds


def median_ms(seconds: list[float]) -> float:
    return 1e3 * statistics.median(seconds)


def time_pass(cloud: Cloud, part: Part, depth: bool) -> Callable[[], float]:
    """A function that renders a cloud as `rasterization` does, with all gradients; it returns seconds."""
    leaves = [getattr(cloud, name).clone().requires_grad_() for name in NAMES]
    size = (cloud.height, cloud.width)
    grads = [torch.ones(*size, cloud.colors.shape[1]), *([torch.ones(size)] if depth else [])]

    def run() -> float:
        start = time.perf_counter()
        camera = Pinhole(cloud.viewmat, cloud.K, cloud.width, cloud.height).to(leaves[0])
        view = render_view(GaussianTensors(*leaves), camera, depth=depth, backend="cpu")  # type: ignore[arg-type]
        middle = time.perf_counter()
        if part != "forward":
            torch.autograd.backward([view.image, view.requested_depth] if depth else [view.image], grads)
        end = time.perf_counter()
        for leaf in leaves:
            leaf.grad = None
        return {"forward": middle - start, "backward": end - middle, "both": end - start}[part]

    return run


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

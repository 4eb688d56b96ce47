"""`python -m benchmarks.growth`: growth of cost with Gaussians, pixels, channels and views: fitted exponents."""

from __future__ import annotations

import argparse
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from matplotlib.figure import Figure

from benchmarks.common.clouds import NAMES, Cloud, random_cloud
from benchmarks.common.timing import interleave, median_ms
from tdgbench.splats import rasterization
from tdgbench.splats.cpu import scratch

AXES = ("gaussians", "pixels", "channels", "views")


def measure(largest: int, width: int, height: int, repetitions: int) -> pd.DataFrame:
    """Return one row per axis and size: ms, and working memory in MB. Depth is not rendered."""
    base = random_cloud(largest, width, height)
    cases: dict[tuple[str, int], tuple[Cloud, int, int]] = {}
    for part in (16, 8, 4, 2, 1):
        cases["gaussians", largest // part] = (_first(base, largest // part), 1, 1)
    for part in (4, 3, 2, 1):
        w, h = width // part, height // part
        cases["pixels", w * h] = (random_cloud(largest, w, h), 1, 1)
    for channels in (1, 2, 3, 4):
        cases["channels", channels] = (base, channels, 1)
    for views in (1, 2, 4, 8):
        cases["views", views] = (_first(base, largest // 4), 1, views)
    memory = {key: _working_memory(_run(*case)) for key, case in cases.items()}
    seconds = interleave({f"{a}|{n}": _run(*case) for (a, n), case in cases.items()}, repetitions)
    return pd.DataFrame(
        [
            {"axis": axis, "size": size, "ms": median_ms(seconds[f"{axis}|{size}"]), "memory_mb": memory[axis, size]}
            for axis, size in cases
        ]
    )


def exponents(table: pd.DataFrame) -> pd.DataFrame:
    """Fit cost ∝ size^exponent by least squares in logarithms; return one row per axis."""
    rows = []
    for axis, points in table.groupby("axis", sort=False):
        logs = np.log(points[["size", "ms", "memory_mb"]].to_numpy(float))
        slope = {name: np.polyfit(logs[:, 0], logs[:, i], 1)[0] for i, name in ((1, "time"), (2, "memory"))}
        rows.append({"axis": axis, **slope})
    return pd.DataFrame(rows)


def _first(cloud: Cloud, count: int) -> Cloud:
    """The first `count` Gaussians of a cloud."""
    return replace(cloud, **{name: getattr(cloud, name)[:count] for name in NAMES})


def _run(cloud: Cloud, channels: int, views: int) -> Callable[[], float]:
    """Function that renders a cloud forward and backward and returns the seconds."""
    values = torch.cat([cloud.colors, cloud.colors[:, :1]], dim=1)[:, :channels]
    leaves = [t.clone().requires_grad_() for t in (cloud.means, cloud.quats, cloud.scales, cloud.opacities, values)]
    viewmats = cloud.viewmat.repeat(views, 1, 1)
    viewmats[:, 0, 3] = torch.linspace(0, 0.2, views)
    Ks = cloud.K.repeat(views, 1, 1)

    def run() -> float:
        start = time.perf_counter()
        means, quats, scales, opacities, colors = leaves
        image, _, _ = rasterization(
            means, quats, scales, opacities, colors, viewmats, Ks, cloud.width, cloud.height, backend="cpu"
        )  # fmt: skip
        image.sum().backward()
        return time.perf_counter() - start

    return run


def _working_memory(run: Callable[[], float]) -> float:
    """Peak of NumPy's memory during a run, MB, starting with an empty workspace. A first run compiles."""
    run()
    scratch.free_buffers()
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1] / 1e6
    finally:
        tracemalloc.stop()


def draw(table: pd.DataFrame, fitted: pd.DataFrame, target: Path) -> None:
    """Draw time and memory against size, one panel per axis."""
    figure = Figure(figsize=(3.4 * len(AXES), 3), layout="constrained")
    slopes = fitted.set_index("axis")
    for panel, axis in zip(figure.subplots(1, len(AXES)), AXES, strict=True):
        rows = table[table["axis"] == axis]
        panel.loglog(rows["size"], rows["ms"], "o-", label=f"ms, exponent {slopes.loc[axis, 'time']:.2f}")
        panel.loglog(rows["size"], rows["memory_mb"], "s--", label=f"MB, exponent {slopes.loc[axis, 'memory']:.2f}")
        panel.set_xlabel(axis)
        panel.grid(linewidth=0.3)
        panel.legend(fontsize=7)
    figure.savefig(target, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--largest", type=int, default=80_000, help="number of Gaussians")
    parser.add_argument("--size", default="320x240", help="width x height, px")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    width, height = (int(n) for n in args.size.split("x"))
    table = measure(args.largest, width, height, args.repetitions)
    fitted = exponents(table)
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "growth.csv", index=False)
    fitted.to_csv(args.out / "growth_exponents.csv", index=False)
    draw(table, fitted, args.out / "growth.png")
    print("cost ∝ size^exponent")
    print(fitted.to_string(index=False, float_format="{:.2f}".format))


if __name__ == "__main__":
    main()

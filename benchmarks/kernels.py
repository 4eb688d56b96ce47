"""`python -m benchmarks.kernels`: time of the splat core's settings against their errors of image, depth and gradients.

Milliseconds are of a forward pass, and of forward and backward. The settings of one cloud take turns in one process.
The oracle is plain torch in float64, tile by tile.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import pandas as pd
import torch
from matplotlib.figure import Figure
from torch import Tensor

from benchmarks.common.clouds import Result, on_backend, random_cloud, render, trained_cloud
from benchmarks.common.timing import interleave, median_ms, time_pass
from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.cpu import pool

BASELINE = "cpu"
MARKERS = "osD^vP*X"
DRAWN_ZERO = 1e-9  # an error of zero is drawn here
PARTS: tuple[Literal["forward", "both"], ...] = ("forward", "both")


@dataclass(frozen=True)
class Setting:
    """A way to render. backend: `cpu`, `cuda`, `torch` (plain torch in float32) or `oracle` (the same in float64)."""

    backend: str = "cpu"
    threads: int | None = None
    blending: Blending = AS_3DGS


def settings(slow: bool) -> dict[str, Setting]:
    """Return the settings by name; plain torch only with `slow`."""
    chosen = {
        BASELINE: Setting(),
        "cpu, 1 thread": Setting(threads=1),
        "cpu, tiles never end early": Setting(blending=replace(AS_3DGS, end_early=False)),
        "cpu, alpha cut at 1/1000": Setting(blending=replace(AS_3DGS, min_alpha=1e-3)),
        "cpu, alpha cut at 1/64": Setting(blending=replace(AS_3DGS, min_alpha=1 / 64)),
        "cpu, stop at T 1e-2": Setting(blending=replace(AS_3DGS, min_transmittance=1e-2)),
        "cpu, stop at T 1e-6": Setting(blending=replace(AS_3DGS, min_transmittance=1e-6)),
    }
    chosen |= {name: Setting(name) for name in fast_backends() if name != "cpu"}
    if slow:
        chosen["torch float32"] = Setting("torch")
        chosen["torch float64"] = Setting("oracle")
    return chosen


def measure(clouds: dict[str, Cloud], repetitions: int, slow: bool) -> pd.DataFrame:
    """Return one row per scene and setting: median ms, their ratios to the baseline, and errors.

    image_error, depth_error: root mean square over pixels, relative to the largest value. gradient_error: norm of the
    difference over the norm, the largest of the five parameters.
    """
    rows = [row for scene, cloud in clouds.items() for row in _measure_scene(scene, cloud, repetitions, slow)]
    table = pd.DataFrame(rows)
    masks = [non_dominated(group, "both_ms", "gradient_error") for _, group in table.groupby("scene", sort=False)]
    return table.assign(non_dominated=pd.concat(masks))


def _measure_scene(scene: str, cloud: Cloud, repetitions: int, slow: bool) -> list[dict[str, Any]]:
    g = torch.Generator().manual_seed(0)
    weights = torch.randn(cloud.height, cloud.width, 5, generator=g, dtype=torch.float64)
    want, oracle_ms = _oracle(cloud, torch.float64, weights)
    runs: dict[str, Callable[[], float]] = {}
    ms: dict[str, float] = {}
    errors: dict[str, dict[str, float]] = {}
    for name, setting in settings(slow).items():
        if setting.backend not in ("torch", "oracle"):
            errors[name] = _errors(on_backend(cloud, setting.backend, weights, setting.blending), want)
            runs |= {f"{name}|{part}": _timed(cloud, setting, part) for part in PARTS}
        elif setting.backend == "torch":  # takes seconds, so it is timed once
            got, taken = _oracle(cloud, torch.float32, weights)
            errors[name], ms = _errors(got, want), ms | {f"{name}|{part}": t for part, t in taken.items()}
        else:
            errors[name], ms = _errors(want, want), ms | {f"{name}|{part}": t for part, t in oracle_ms.items()}
    ms |= {name: median_ms(taken) for name, taken in interleave(runs, repetitions).items()}
    rows = []
    for name in settings(slow):
        row: dict[str, Any] = {"scene": scene, "gaussians": len(cloud.means), "setting": name}
        for part in PARTS:
            row[f"{part}_ms"] = ms[f"{name}|{part}"]
            row[f"{part}_ratio"] = ms[f"{name}|{part}"] / ms[f"{BASELINE}|{part}"]
        rows.append({**row, **errors[name]})
    return rows


def non_dominated(table: pd.DataFrame, time_column: str, error_column: str) -> pd.Series:
    """Mask of the rows that no other row beats in both columns; errors are compared by their first digit."""
    seconds = table[time_column]
    errors = table[error_column].map(lambda e: float(f"{e:.0e}"))

    def is_dominated(t: float, e: float) -> bool:
        as_good = (seconds <= t) & (errors <= e)
        return bool((as_good & ((seconds < t) | (errors < e))).any())

    return pd.Series([not is_dominated(t, e) for t, e in zip(seconds, errors, strict=True)], index=table.index)


def _oracle(cloud: Cloud, dtype: torch.dtype, weights: Tensor) -> tuple[Result, dict[str, float]]:
    """Plain torch's render of a scene, and its milliseconds."""
    start = time.perf_counter()
    render(cloud, dtype, None)
    middle = time.perf_counter()
    result = render(cloud, dtype, weights)
    end = time.perf_counter()
    return result, {"forward": 1e3 * (middle - start), "both": 1e3 * (end - middle)}


def _errors(got: Result, want: Result) -> dict[str, float]:
    """Errors of a render by column name."""

    def relative_rms(a: Tensor, b: Tensor) -> float:
        return ((a.double() - b.double()).square().mean().sqrt() / b.abs().max()).item()

    gradients = [
        ((got.gradients[name].double() - exact.double()).norm() / exact.double().norm()).item()
        for name, exact in want.gradients.items()
    ]
    return {
        "image_error": relative_rms(got.image[..., :-1], want.image[..., :-1]),
        "depth_error": relative_rms(got.image[..., -1], want.image[..., -1]),
        "gradient_error": max(gradients),
    }


def _timed(cloud: Cloud, setting: Setting, part: Literal["forward", "both"]) -> Callable[[], float]:
    """A function that renders a cloud with the threads of a setting and returns the seconds of a part."""
    run = time_pass(cloud, part, setting.backend, setting.blending)

    def with_threads() -> float:
        before = pool._threads
        pool.set_threads(setting.threads if setting.threads is not None else before)
        try:
            return run()
        finally:
            pool.set_threads(before)

    return with_threads


def draw(table: pd.DataFrame, target: Path) -> None:
    """Draw time against error, logarithmic, one panel per scene; non-dominated settings are joined and named."""
    scenes, settings_drawn = table["scene"].unique(), table["setting"].unique()
    figure = Figure(figsize=(5 * len(scenes) + 2.4, 4.6), layout="constrained")
    panels = figure.subplots(1, len(scenes), squeeze=False)[0]
    for axes, scene in zip(panels, scenes, strict=True):
        rows = table[table["scene"] == scene].assign(error=lambda t: t["gradient_error"].clip(lower=DRAWN_ZERO))
        front = rows[rows["non_dominated"]].sort_values("both_ms")
        axes.loglog(front["both_ms"], front["error"], color="tab:red", linewidth=1, zorder=1)
        for i, setting in enumerate(settings_drawn):
            point = rows[rows["setting"] == setting]
            marker, color = MARKERS[i % len(MARKERS)], f"C{i % 10}"
            axes.scatter(point["both_ms"], point["error"], s=26, marker=marker, color=color, label=setting, zorder=2)
        for row in front.itertuples():
            axes.annotate(row.setting, (row.both_ms, row.error), fontsize=7, xytext=(4, 4), textcoords="offset points")
        axes.set(xlabel="forward + backward, ms", ylabel=f"error of the gradients (0 is drawn at {DRAWN_ZERO:g})")
        axes.set_title(scene, fontsize=9)
        axes.grid(linewidth=0.3)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right center", fontsize=7)
    figure.savefig(target, dpi=130)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.kernels", description=__doc__)
    parser.add_argument("--counts", type=int, nargs="*", default=[20_000, 100_000])
    parser.add_argument("--size", default="320x240", help="width x height, px")
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--torch", action="store_true", help="also plain torch, at seconds per call")
    parser.add_argument("--model", type=Path, help="model.ply of a cell, rendered from a test view of --data")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    if (args.model is None) != (args.data is None):
        parser.error("--model and --data go together")
    if not args.counts and args.model is None:
        parser.error("needs --counts, or --model and --data")
    torch.set_num_threads(1)
    width, height = (int(n) for n in args.size.split("x"))
    clouds = {f"{n:,} random, {width}×{height}": random_cloud(n, width, height) for n in args.counts}
    if args.model is not None:
        clouds["trained"] = trained_cloud(args.model, args.data)
    table = measure(clouds, args.repetitions, args.torch)
    args.out.mkdir(parents=True, exist_ok=True)
    table.to_csv(args.out / "kernels.csv", index=False)
    draw(table, args.out / "kernels.png")
    print(table.drop(columns="gaussians").to_string(index=False, float_format=lambda number: f"{number:.3g}"))


if __name__ == "__main__":
    main()

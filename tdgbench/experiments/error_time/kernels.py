"""Kernels: milliseconds of a forward pass, and of forward and backward, against errors of image, depth and gradients.

The settings of one scene take turns in one process. The oracle is plain torch in float64, tile by tile.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import pandas as pd
import torch
from torch import Tensor

from tdgbench.bench.backend_check.compare import Cloud
from tdgbench.experiments.error_time.clouds import Result, on_backend, render
from tdgbench.experiments.error_time.timing import interleave, median_ms, time_pass
from tdgbench.splats.backends import fast_backends
from tdgbench.splats.blending import AS_3DGS, Blending
from tdgbench.splats.cpu import pool

BASELINE = "cpu"
PARTS: tuple[Literal["forward", "both"], ...] = ("forward", "both")


@dataclass(frozen=True)
class Setting:
    """A way to render. backend: `cpu`, `cuda`, `torch` (plain torch in float32) or `oracle` (the same in float64)."""

    backend: str = "cpu"
    threads: int | None = None
    blending: Blending = AS_3DGS


def settings(slow: bool) -> dict[str, Setting]:
    """Settings by name; plain torch only with `slow`."""
    chosen = {
        BASELINE: Setting(),
        "cpu, 1 thread": Setting(threads=1),
        "cpu, loose bounds": Setting(blending=replace(AS_3DGS, tight=False)),
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
    """One row per scene and setting: median ms, their ratios to the baseline, and errors.

    image_error, depth_error: root mean square over pixels, relative to the largest value. gradient_error: norm of the
    difference over the norm, the largest of the five parameters.
    """
    rows = [row for scene, cloud in clouds.items() for row in _measure_scene(scene, cloud, repetitions, slow)]
    return pd.DataFrame(rows)


def _measure_scene(scene: str, cloud: Cloud, repetitions: int, slow: bool) -> list[dict[str, Any]]:
    weights = torch.randn(
        cloud.height, cloud.width, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64
    )  # fmt: skip
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
        before = pool.chosen_threads()
        pool.set_threads(setting.threads if setting.threads is not None else before)
        try:
            return run()
        finally:
            pool.set_threads(before)

    return with_threads

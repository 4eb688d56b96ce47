"""`python -m benchmarks.thermal`: errors of the thermal camera estimated before training, where the true one is known.

Each made scene, also those along a surface (`field`, `hills`, `wall`), is rendered once, in °C with the noise of a
camera. Then cameras drift, one per seed: offsets of ±4 °C with a shutter, gains of ±5 %, 2.6 °C of vignette. Printed
are true and estimated numbers, and the errors, which are judged: 0.1 °C (offset), 2 % (gain), 0.2 °C (vignette) at
most, and 0.02 °C RMS of change of a scene without drift. Exits with 1 if an error is beyond its bound. `--folder` takes
captures in their place: what comes back of a known drift beside their own camera, which is unknown; nothing is judged
then.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from tdgbench.scenes import FolderDataset, ReadOptions, Scene
from tdgbench.scenes.synthetic import CaptureErrors, SyntheticDataset, ThermalErrors
from tdgbench.scenes.synthetic.drifting import drifting, in_degC
from tdgbench.scenes.synthetic.truth import CameraTruth
from tdgbench.scenes.synthetic.worlds import WORLDS
from tdgbench.thermal import ThermalCamera, correct_values, estimate_camera
from tdgbench.thermal.camera import normalized_truth
from tdgbench.thermal.maps import evaluate

BOUNDS = {"offset": 0.1, "gain": 0.02, "vignette": 0.2, "clean": 0.02}  # °C; of gains, a share of 1


class ThermalCameraErrors(NamedTuple):
    """Estimated minus true: offsets (V,) in °C, gains (V,), vignette (H, W) in °C."""

    offsets: np.ndarray
    gains: np.ndarray
    vignette: np.ndarray


def errors_of(camera: ThermalCamera, truth: CameraTruth) -> ThermalCameraErrors:
    """Return the errors of an estimate in °C."""
    true = normalized_truth(truth, camera.views, camera.reference)
    height, width = true.vignette.shape
    return ThermalCameraErrors(
        camera.offsets - true.response.offsets,
        camera.gains - true.response.gains,
        evaluate(camera.vignette, width, height) - true.vignette,
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.thermal", description=__doc__)
    parser.add_argument("--size", default="640x480", help="width x height, px")
    parser.add_argument("--views", type=int, default=40)
    parser.add_argument("--points", type=int, default=20_000)
    parser.add_argument("--seeds", type=int, default=3, help="of cameras")
    parser.add_argument("--scene", nargs="+", default=list(WORLDS))
    parser.add_argument("--folder", nargs="+", type=Path, default=[], help="captures in °C, in place of made scenes")
    parser.add_argument("--walk", type=float, default=4.0, help="largest offset, °C")
    parser.add_argument("--gain", type=float, default=0.05)
    parser.add_argument("--vignette", type=float, default=2.6, help="°C at the corners")
    parser.add_argument("--data", type=Path, default=Path("data"))
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    errors = ThermalErrors(walk_degC=args.walk, shutter_views=15, gain=args.gain, vignette_degC=args.vignette)
    runs, views = [], []
    for clean in _scenes(args):
        own, run = _clean(clean)
        runs.append(run)
        print(_line(runs[-1]), flush=True)
        for seed in range(args.seeds):
            summary, table = _drifting(clean, errors, seed, own if args.folder else None)
            runs.append(summary)
            views.append(table)
            print(_line(summary), flush=True)
    args.out.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(runs).to_csv(args.out / "thermal.csv", index=False)
    pd.concat(views).to_csv(args.out / "thermal_views.csv", index=False)
    wrong = [] if args.folder else beyond(runs)
    if wrong:
        print(f"beyond its bound: {', '.join(wrong)}")
        sys.exit(1)


def beyond(runs: list[dict[str, Any]]) -> list[str]:
    """Errors that are beyond their bounds.

    >>> beyond([{"scene": "orbit", "seed": 0, "gain_worst": 0.03, "offset_worst": 0.01}])
    ['gain of orbit 0']
    """
    return [
        f"{name} of {run['scene']} {run['seed']}"
        for run in runs
        for name, bound in BOUNDS.items()
        if run.get(f"{name}_worst", 0) > bound
    ]


def _scenes(args: argparse.Namespace) -> Iterator[Scene]:
    if args.folder:
        yield from (FolderDataset(str(folder), ReadOptions()).load(None) for folder in args.folder)
        return
    width, height = (int(number) for number in args.size.split("x"))
    capture = CaptureErrors(thermal_camera=ThermalErrors(encoding="degC"))
    dataset = SyntheticDataset(
        str(args.data), ReadOptions(), width, height, args.views, args.points, seed=0, errors=capture
    )  # fmt: skip
    yield from (dataset.load(name) for name in args.scene)


def _clean(scene: Scene) -> tuple[ThermalCamera, dict[str, Any]]:
    """The camera of a scene as it is, and what correcting for it changes."""
    start = time.perf_counter()
    camera = _estimated(scene)
    seconds = time.perf_counter() - start
    change = [correct_values(in_degC(view, scene), view.name, camera) - in_degC(view, scene) for view in scene.train]
    return camera, {
        "scene": scene.name, "seed": "clean", "seconds": seconds, "estimated": camera.summary,
        "clean_worst": float(np.sqrt(np.mean(np.square(change)))), "notes": "; ".join(camera.notes),
    }  # fmt: skip


def _drifting(
    clean: Scene, errors: ThermalErrors, seed: int, own: ThermalCamera | None
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Errors of the estimate of a camera; true and estimated numbers of each view. own: what drifted before."""
    scene, truth = drifting(clean, errors, seed)
    if own is not None:
        vignette = truth.camera.vignette + evaluate(own.vignette, *reversed(truth.camera.vignette.shape))
        truth = replace(truth, camera=replace(truth.camera, vignette=vignette))
    start = time.perf_counter()
    camera = _estimated(scene)
    seconds = time.perf_counter() - start
    true, found = normalized_truth(truth, camera.views, camera.reference), errors_of(camera, truth)
    summary: dict[str, Any] = {"scene": scene.name, "seed": seed, "seconds": seconds}
    for name, error in (("offset", found.offsets), ("gain", found.gains), ("vignette", found.vignette)):
        summary |= {f"{name}_rms": float(np.sqrt(np.mean(error**2))), f"{name}_worst": float(np.abs(error).max())}
    low, high = true.response.offsets.min(), true.response.offsets.max()
    summary["true"] = (
        f"offsets {low:+.2f} to {high:+.2f}, gains {true.response.gains.min():.3f} to {true.response.gains.max():.3f}, "
        f"vignette {np.ptp(true.vignette):.2f}"
    )
    summary |= {"undetermined": camera.undetermined, "estimated": camera.summary, "notes": "; ".join(camera.notes)}
    table = pd.DataFrame(
        {
            "scene": scene.name, "seed": seed, "view": camera.views,
            "true_offset": true.response.offsets, "offset": camera.offsets,
            "true_gain": true.response.gains, "gain": camera.gains,
        }
    )  # fmt: skip
    return summary, table


def _estimated(scene: Scene) -> ThermalCamera:
    camera = estimate_camera(scene)
    if not isinstance(camera, ThermalCamera):
        sys.exit(camera.reason)
    return camera


def _line(run: dict[str, Any]) -> str:
    head, tail = f"{run['scene']} {run['seed']}: ", f"{run['seconds']:.0f} s"
    if run["seed"] == "clean":
        return f"{head}changed by {run['clean_worst']:.4f} °C RMS; {run['estimated']} ({run['notes']}); {tail}"
    said = [f"{name} {run[f'{name}_rms']:.4f} RMS, {run[f'{name}_worst']:.4f} worst" for name in list(BOUNDS)[:3]]
    seen = f"estimated {run['estimated']}, {run['undetermined']} directions undetermined"
    return f"{head}true {run['true']}; {seen}; errors: {'; '.join(said)}; {tail}"


if __name__ == "__main__":
    main()

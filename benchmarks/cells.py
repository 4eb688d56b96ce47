"""`python -m benchmarks.cells`: what a cell costs beside its training, in seconds and ratios.

scoring   the test views of a scene, on one thread and on all, in turns; the scores must be equal
again     a finished sweep of 28 small cells, run again: with its stamp, and without, so that each cell is checked and
          tables and report are made anew, in turns

Exits with 1 where scoring gains nothing from further threads, or a repeated sweep takes longer than NEEDED_SECONDS.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks.common.timing import interleave
from tdgbench.experiments.stamp import FILE
from tdgbench.resources import PACKAGE
from tdgbench.scenes import Camera, Scene, View
from tdgbench.scoring import LPIPSOptions, RenderedImages, Scorer
from tdgbench.scoring.backbones import make_trunk
from tdgbench.splats.cpu import pool

NEEDED_SECONDS = 3.0  # of a repeated sweep of 28 cells
NEEDED_RATIO = 0.9  # of the time on all threads over that on one
SWEEP = ("-m", "dataset=synthetic", "scene=orbit,night,turntable,facade", "seed=0,1,2,3,4,5,6", "method=splat",
         "budget=demo", "budget.iterations=3", "metrics.lpips.download=false", "dataset.loader.width=48",
         "dataset.loader.height=36", "dataset.loader.views=10", "dataset.loader.points=300")  # fmt: skip


def random_scene(views: int, width: int, height: int) -> tuple[Scene, dict[str, RenderedImages]]:
    """Test views of noise, and renders of them."""
    rng = np.random.default_rng(0)
    K = np.array([[width, 0, width / 2], [0, width, height / 2], [0, 0, 1.0]])
    found, renders = [], {}
    for number in range(views):
        pose = np.eye(4)
        pose[0, 3] = 0.01 * number
        image, render = (rng.random((height, width, 1), np.float32) for _ in range(2))
        found.append(View(f"view{number}", Camera(K, pose, width, height), image.copy))
        renders[found[-1].name] = RenderedImages(render, np.ones((height, width), np.float32))
    scene = Scene("noise", "", "", [], found, None, None, "", "", channels=1)
    return scene, renders


def random_weights(net: str, folder: Path) -> Path:
    """File of a backbone with random weights: the time does not depend on them."""
    path = folder / f"{net}.npz"
    np.savez(path, **{f"features.{name}": value.numpy() for name, value in make_trunk(net).state_dict().items()})
    return path


def time_scoring(net: str, views: int, size: tuple[int, int], repetitions: int) -> dict[int, list[float]]:
    """Seconds of scoring, in turns, by number of threads. Raises ValueError if the scores depend on it."""
    scene, renders = random_scene(views, *size)
    scores = {}
    with tempfile.TemporaryDirectory() as folder:
        options = LPIPSOptions(net, str(random_weights(net, Path(folder))), False)  # type: ignore[arg-type]
        scorer = Scorer("3dgs", "zero", "unit", options)
        _ = scorer.lpips(np.zeros((64, 64, 1)), np.ones((64, 64, 1)))  # loads the network

    def with_threads(threads: int) -> Callable[[], float]:
        def run() -> float:
            pool.set_threads(threads)
            start = time.perf_counter()
            scores[threads] = scorer.score(scene, renders)
            return time.perf_counter() - start

        return run

    times = interleave({n: with_threads(n) for n in sorted({1, pool.available_cores()})}, repetitions)
    pool.set_threads(None)
    if any(found != scores[1] for found in scores.values()):
        raise ValueError("the scores depend on the number of threads")
    return times


def time_again(repetitions: int) -> tuple[list[float], list[float]]:
    """Seconds of a repeated sweep with its stamp and without, in turns."""
    with tempfile.TemporaryDirectory() as folder:
        stamp = Path(folder, "results", "single", FILE)
        for _ in range(2):  # the first one writes the scenes
            _run(folder)
        told, checked = [], []
        for _ in range(repetitions):
            told.append(_run(folder))
            stamp.unlink()
            checked.append(_run(folder))
    return told, checked


def _run(folder: str) -> float:
    """Seconds of the sweep in a new process. Raises CalledProcessError if it fails."""
    start = time.perf_counter()
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    subprocess.run(
        [sys.executable, "-m", "tdgbench", *SWEEP], cwd=folder, env=environment, check=True, capture_output=True
    )  # fmt: skip
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cells", description=__doc__)
    parser.add_argument("--net", default="vgg", choices=("vgg", "alex", "squeeze"))
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--repetitions", type=int, default=3)
    parser.add_argument("--parts", nargs="+", default=["scoring", "again"], choices=("scoring", "again"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    failed = False
    if "scoring" in args.parts:
        width, height = map(int, args.size.split("x"))
        times = time_scoring(args.net, args.views, (width, height), args.repetitions)
        one, most = times[1], times[max(times)]
        ratio = statistics.median(b / a for a, b in zip(one, most, strict=True))
        print(
            f"scoring {args.views} views of {args.size}, {args.net}: {statistics.median(one):.2f} s on one thread, "
            f"{statistics.median(most):.2f} s on {max(times)}, ratio {ratio:.2f}; equal scores"
        )
        failed |= len(times) > 1 and ratio > NEEDED_RATIO
    if "again" in args.parts:
        told, checked = time_again(args.repetitions)
        ratio = statistics.median(a / b for a, b in zip(told, checked, strict=True))
        median, other = statistics.median(told), statistics.median(checked)
        print(
            f"28 cells again: {median:.2f} s where nothing changed, {other:.2f} s without a stamp, ratio {ratio:.2f}; "
            f"{median / NEEDED_SECONDS:.2f} × {NEEDED_SECONDS:g} s"
        )
        failed |= median > NEEDED_SECONDS
    if failed:
        sys.exit(1)


if __name__ == "__main__":
    main()

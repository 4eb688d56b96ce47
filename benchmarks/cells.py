"""`python -m benchmarks.cells`: what a cell costs beside its training, in seconds and ratios.

It scores the test views of a scene on one thread and on all, in turns; the scores must be equal. Exits with 1 where
scoring gains nothing from further threads.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from benchmarks.common.timing import interleave
from tdgbench.scenes import Camera, Scene, View
from tdgbench.scoring import LPIPSOptions, RenderedImages, Scorer
from tdgbench.scoring.backbones import make_trunk
from tdgbench.splats.cpu import pool

NEEDED_RATIO = 0.9  # of the time on all threads over that on one


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


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cells", description=__doc__)
    parser.add_argument("--net", default="vgg", choices=("vgg", "alex", "squeeze"))
    parser.add_argument("--views", type=int, default=4)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--repetitions", type=int, default=3)
    args = parser.parse_args()
    torch.set_num_threads(1)
    width, height = map(int, args.size.split("x"))
    times = time_scoring(args.net, args.views, (width, height), args.repetitions)
    one, most = times[1], times[max(times)]
    ratio = statistics.median(b / a for a, b in zip(one, most, strict=True))
    print(
        f"scoring {args.views} views of {args.size}, {args.net}: {statistics.median(one):.2f} s on one thread, "
        f"{statistics.median(most):.2f} s on {max(times)}, ratio {ratio:.2f}; equal scores"
    )
    if len(times) > 1 and ratio > NEEDED_RATIO:
        sys.exit(1)


if __name__ == "__main__":
    main()

"""`python -m benchmarks.training [hydra overrides]`: milliseconds of a training step and of its parts.

The configuration is that of `python -m tdgbench` (data set, method, budget …). `--steps` steps warm up, as many are
measured.
"""

from __future__ import annotations

import argparse
import functools
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pandas as pd
import torch
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from omegaconf import DictConfig

from tdgbench.bench.setup import set_up
from tdgbench.resources import conf_folder
from tdgbench.splats.cpu import pool
from tdgbench.splats.density import DensityControl
from tdgbench.splats.optimizer import Adam
from tdgbench.training.growth import GrowthTest
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.settling import Settling

PART_OF_MODULE = {  # modules of kernels, below tdgbench or tdgbench.splats.cpu
    "raster.culling": "project",
    "raster.projection_forward": "project",
    "raster.tiles": "bin",
    "raster.blend": "blend",
    "raster.blend_backward": "blend backward",
    "raster.projection_backward": "projection backward, Adam",
    "raster.dense": "gather and scatter",
    "adam": "Adam",
    "statistics": "density control",
    "losses.photometric": "losses",
    "losses.rows": "losses",
    "losses.minmax": "losses",
    "fields.hash_grid": "hash grid",
    "fields.networks": "networks",
    "fields.kernels": "Adam",
}
REMAINDER = "Python and torch"


class StepProfile:
    """Seconds by part. What runs within a part counts for that part: renders of growth are its own."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._is_inside = False

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Context that times kernels, optimiser and density control."""
        with ExitStack() as stack:
            stack.enter_context(self._timed(pool, "run", part_of_kernel))
            stack.enter_context(self._timed(Adam, "step", lambda *_: "Adam"))
            stack.enter_context(self._timed(GrowthTest, "measure", lambda *_: "growth"))
            stack.enter_context(self._timed(Settling, "reached", lambda *_: "held-out views"))
            for name in ("observe_visible", "observe_gradients", "update"):
                stack.enter_context(self._timed(DensityControl, name, lambda *_: "density control"))
            yield

    @contextmanager
    def _timed(self, owner, attribute: str, part_of) -> Iterator[None]:
        """Context in which a function of `owner` times itself; part_of gives the part from its arguments."""
        original = getattr(owner, attribute)

        @functools.wraps(original)
        def timed(*args, **kwargs):
            if self._is_inside:
                return original(*args, **kwargs)
            self._is_inside, start = True, time.perf_counter()
            try:
                return original(*args, **kwargs)
            finally:
                self._is_inside = False
                self.seconds[part_of(*args)] += time.perf_counter() - start

        setattr(owner, attribute, timed)
        try:
            yield
        finally:
            setattr(owner, attribute, original)


def part_of_kernel(kernel, _arguments) -> str:
    """Part of a step that a kernel belongs to."""
    return PART_OF_MODULE[kernel.__module__.removeprefix("tdgbench.").removeprefix("splats.cpu.")]


def measure_step(cfg: DictConfig, steps: int) -> pd.DataFrame:
    """Train the configured method. Return part, ms, share of a step, longest first; `steps` steps warm up before."""
    scene = instantiate(cfg.dataset.loader).load(cfg.scene)
    cfg.budget.iterations = 2 * steps
    trainer, profile, before = set_up(cfg, scene).trainer, StepProfile(), 0.0
    with ExitStack() as stack:

        def begin(log: TrainingLog) -> None:
            nonlocal before
            if log.iterations == steps:
                before = log.seconds
                stack.enter_context(profile.watch())

        log = train(trainer, after_iteration=begin)
    total, steps = log.seconds - before, log.iterations - steps
    seconds = {**profile.seconds, REMAINDER: total - sum(profile.seconds.values())}
    parts = pd.DataFrame([{"part": part, "ms": 1e3 * s / steps} for part, s in seconds.items()])
    parts = parts.sort_values("ms", ascending=False)
    parts["share"] = parts["ms"] / (1e3 * total / steps)
    print(f"{sum(map(len, trainer.gaussians.values()))} Gaussians, {pool.get_threads()} threads")
    return parts


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.training", description=__doc__)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("--steps", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        cfg = compose("config", overrides=["backend=cpu", *args.overrides])  # whose kernels it times
    parts = measure_step(cfg, args.steps)
    for row in parts.itertuples():
        print(f"{row.part:<20}{row.ms:8.2f} ms {100 * row.share:6.1f} %")
    print(f"{'whole step':<20}{parts['ms'].sum():8.2f} ms")
    args.out.mkdir(parents=True, exist_ok=True)
    parts.to_csv(args.out / "training.csv", index=False)


if __name__ == "__main__":
    main()

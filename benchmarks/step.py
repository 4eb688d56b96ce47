"""`python -m benchmarks.step`: milliseconds of a training step of N random Gaussians, by part, in all and per Gaussian.

--counts N ...     numbers of Gaussians; 3.2 million need about 2 GB with one channel
--channels, --degree, --depth, --size   of the render; --share: part of the Gaussians that a view sees
Times are of the processor, all threads together, which other programs change least. No data is needed.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from benchmarks.training import REMAINDER, part_of_kernel
from tdgbench.resources import conf_folder
from tdgbench.scenes import Camera
from tdgbench.splats import Gaussians
from tdgbench.splats.cpu import pool
from tdgbench.training.budget import Budget
from tdgbench.training.losses import thermal_loss
from tdgbench.training.model import SplatModel

VIEWS = 16
ITERATION = 5001  # density control observes, and changes nothing
WARM_UP = VIEWS  # steps


def paper_budget() -> Budget:
    """The budget of the paper's protocol."""
    cfg = OmegaConf.create({"budget": OmegaConf.load(conf_folder() / "budget" / "paper.yaml")})
    cfg.budget.iterations = 10_000
    return instantiate(cfg.budget)


def make_model(count: int, channels: int, degree: int, focal: float) -> SplatModel:
    """A model on the unit sphere, its Gaussians one to two pixels wide when seen from the centre."""
    g = torch.Generator().manual_seed(0)
    means = torch.nn.functional.normalize(torch.randn(count, 3, generator=g), dim=1)
    means = means * (1 + 0.02 * torch.randn(count, 1, generator=g))
    start = Gaussians(
        means=means,
        log_scales=torch.randn(count, 3, generator=g) * 0.4 + np.log(1.2 / focal),
        quats=torch.randn(count, 4, generator=g),
        opacity_logits=torch.randn(count, generator=g) * 1.5 - 1,
        sh=torch.randn(count, 16, channels, generator=g) * 0.05,
    )
    model = SplatModel(start, paper_budget(), 1.0, "cpu", torch.Generator().manual_seed(0))
    model.degree = degree
    return model


def cameras(width: int, height: int, share: float) -> list[Camera]:
    """Cameras in the centre of the sphere that look around; each sees about a share of it."""
    angle = 4 * np.pi * share  # steradians
    focal = np.sqrt(width * height / angle)
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    views = []
    for turn in 2 * np.pi * np.arange(VIEWS) / VIEWS:
        pose = np.eye(4)
        pose[0, 0] = pose[2, 2] = np.cos(turn)
        pose[0, 2], pose[2, 0] = np.sin(turn), -np.sin(turn)
        views.append(Camera(K, pose, width, height))
    return views


def time_steps(model: SplatModel, views: list[Camera], channels: int, depth: bool, steps: int) -> dict[str, float]:
    """Milliseconds of the processor by part of a step; medians over steps."""
    g = torch.Generator().manual_seed(1)
    target = torch.rand(views[0].height, views[0].width, channels, generator=g)
    spent: dict[str, float] = {}
    run = pool.run

    def timed(function, arguments, **work):
        start = time.process_time()
        try:
            return run(function, arguments, **work)
        finally:
            part = part_of_kernel(function, arguments)
            spent[part] = spent.get(part, 0.0) + time.process_time() - start

    rows: dict[str, list[float]] = defaultdict(list)
    pool.run = timed  # type: ignore[assignment]
    try:
        for turn in range(WARM_UP + steps):
            spent.clear()
            start = time.process_time()
            model.begin(ITERATION)
            render = model.render(views[turn % len(views)], depth=depth)
            loss = thermal_loss(render.image, target, 0.2, 0.6, "released")
            (loss if render.depth is None else loss + 1e-3 * render.depth.mean()).backward()
            model.step(ITERATION)
            whole = time.process_time() - start
            if turn >= WARM_UP:
                for part, seconds in {**spent, REMAINDER: whole - sum(spent.values()), "whole step": whole}.items():
                    rows[part].append(seconds)
    finally:
        pool.run = run
    return {part: 1e3 * float(np.median(seconds)) for part, seconds in rows.items()}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.step", description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[300_000, 3_200_000])
    parser.add_argument("--channels", type=int, default=1, choices=(1, 3))
    parser.add_argument("--degree", type=int, default=3, choices=range(4))
    parser.add_argument("--depth", action="store_true")
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--share", type=float, default=0.2)
    parser.add_argument("--steps", type=int, default=2 * VIEWS)
    parser.add_argument("--out", type=Path, default=Path("results/benchmarks"))
    args = parser.parse_args()
    torch.set_num_threads(1)
    width, height = (int(n) for n in args.size.split("x"))
    views, rows = cameras(width, height, args.share), []
    for count in args.counts:
        model = make_model(count, args.channels, args.degree, views[0].K[0, 0])
        parts = time_steps(model, views, args.channels, args.depth, args.steps)
        work = model.work
        share = work.touched / work.rows
        print(f"{count} Gaussians, {100 * share:.0f} % with a gradient, {pool.get_threads()} threads")
        for part, ms in sorted(parts.items(), key=lambda item: item[1]):
            print(f"  {part:<22}{ms:9.2f} ms {1e6 * ms / count:8.2f} ns a Gaussian", flush=True)
            rows.append({"gaussians": count, "part": part, "ms": ms})
    args.out.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(args.out / "step.csv", index=False)


if __name__ == "__main__":
    main()

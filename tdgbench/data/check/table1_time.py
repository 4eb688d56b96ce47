"""How long the trainings of Table 1 will take here: a range from a short timed training on one scene.

A step costs more the more Gaussians there are, and how many a scene will have is known only after its training. So
steps are timed twice: with the scene's sparse points, which is the least, and with ten times as many.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from tdgbench.bench.setup import set_up
from tdgbench.resources import conf_folder
from tdgbench.scenes import PointCloud, Scene
from tdgbench.scenes.registry import SCENES
from tdgbench.splats.cpu import pool
from tdgbench.training.loop import train
from tdgbench.training.part import Stopping

METHODS = ("msmg", "tdg")
GROWTH = 10  # times the sparse points: Gaussians of the upper end
WARM_UP, AT_A_TIME = 5, 10  # steps
TRAINING_VIEWS = 8  # of the timed training: few, so that priors of the others are not estimated


class Table1Time(NamedTuple):
    """Hours of training of Table 1, low and high: 14 scenes like the measured one, one seed; and how that is known."""

    hours: tuple[float, float]
    text: str


def table1_time(scene: Scene, seconds: float, begin: Callable[[str], None]) -> Table1Time | str:
    """Time steps of each method for `seconds` with few and with many Gaussians; or say why that cannot be done."""
    if scene.points is None:
        return "n/a: no scene with sparse points to time a training on"
    if any(view.load_rgb is None for view in scene.train):
        return "n/a: no scene with RGB images of all training views to time a training on"
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    torch.set_num_threads(1)  # as in a cell: the kernels use a pool of threads
    pool.set_threads(None)
    hours, steps, counts = [0.0, 0.0], [], (0, 0)
    try:
        for method in METHODS:
            begin(f"timing steps of {method} on {scene.name}, {2 * seconds:g} s")
            cfg = _config(method)
            (few, first), (many, last) = (_step_ms(cfg, _part(scene, growth), seconds) for growth in (1, GROWTH))
            ms, counts = sorted((few, many)), (first, last)
            hours = [h + len(SCENES) * cfg.budget.iterations * one / 3.6e6 for h, one in zip(hours, ms, strict=True)]
            steps.append(f"{method} {ms[0]:.0f} to {ms[1]:.0f} ms × {cfg.budget.iterations} steps")
    except Exception as error:  # of a method, prior or backend that does not work here
        return f"n/a: the timed training failed: {error}"
    camera, threads = scene.train[0].camera, pool.get_threads()
    size = f"{camera.width}×{camera.height} px, {counts[0]} and {counts[1]} Gaussians, {threads} threads"
    text = (
        f"Table 1 will train {hours[0]:.1f} to {hours[1]:.1f} hours here: {len(SCENES)} scenes, one seed, one after "
        f"the other ({'; '.join(steps)}; measured on {scene.name}, {size}). Noisy scenes may grow beyond that; depth "
        "priors and scores are not included"
    )
    if load >= threads / 2:
        text += f". The machine was busy (load {load:.1f}): measure again when it is idle"
    return Table1Time((hours[0], hours[1]), text)


def _config(method: str) -> DictConfig:
    overrides = [f"method={method}", "budget=paper", "prior=sfm_points", "skip=default"]
    with initialize_config_dir(str(conf_folder()), version_base="1.3"):
        return compose("config", overrides=overrides)


def _part(scene: Scene, growth: int) -> Scene:
    """The scene with a few training views, and with `growth` times its points, spread by their mean spacing."""
    cloud = scene.points
    assert cloud is not None
    chosen = np.linspace(0, len(scene.train) - 1, min(TRAINING_VIEWS, len(scene.train))).round().astype(int)
    if growth > 1:
        spacing = np.median(np.ptp(cloud.points, axis=0)) / max(1.0, np.sqrt(len(cloud.points)))
        shift = np.random.default_rng(0).normal(0, spacing / 2, (growth, *cloud.points.shape))
        shift[0] = 0
        points = (cloud.points[None] + shift).reshape(-1, 3)
        cloud = PointCloud(points, np.tile(cloud.colors, (growth, 1)))
    return replace(scene, train=[scene.train[i] for i in chosen], points=cloud)


def _step_ms(cfg: DictConfig, scene: Scene, seconds: float) -> tuple[float, int]:
    """Milliseconds of a training step, and the number of Gaussians of the thermal model."""
    trainer = set_up(cfg, scene).trainer
    trainer.stopping = _After(WARM_UP)
    train(trainer)
    trainer.stopping = _After(AT_A_TIME)
    spent, steps = 0.0, 0
    while spent < seconds:
        start = time.perf_counter()
        train(trainer)  # from iteration 1 again: density control, which begins later, is never reached
        spent, steps = spent + time.perf_counter() - start, steps + AT_A_TIME
    return 1e3 * spent / steps, len(trainer.gaussians["thermal"])


class _After(Stopping):
    """Ends a training after so many iterations, whose schedules are those of a longer one."""

    def __init__(self, iterations: int) -> None:
        self.iterations = iterations

    def reached(self, iteration: int, loss: float) -> bool:
        return iteration >= self.iterations

"""Short trainings of a method."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from tdgbench.bench.setup import set_up
from tdgbench.scenes import Scene
from tdgbench.training.loop import train
from tdgbench.training.method import Context, Method
from tdgbench.training.skips import Skips
from tests.helpers.configs import config


class Ready(NamedTuple):
    """A method that is ready to train, and the context it was set up with."""

    method: Method
    context: Context


def ready_to_train(
    scene: Scene, name: str, iterations: int, *overrides: str, seed: int = 0, skips: Skips | None = None
) -> Ready:
    """A method with the demo's budget, ready to train."""
    cfg = config(
        f"method={name}", "prior=synthetic", "budget=demo", f"budget.iterations={iterations}", *overrides
    )  # fmt: skip
    cfg.seed = seed
    method, context, *_ = set_up(cfg, scene, skips=skips, compiles=False)
    return Ready(method, context)


def trained(scene, method_name: str, iterations: int = 60, seed: int = 0, skips: Skips | None = None, **overrides):
    """A method trained for a while, with its log."""
    often = ("budget.density.start=20", "budget.density.every=20", "budget.sh_every=25")
    extra = [f"{k}={v}" for k, v in overrides.items()]
    method, _ = ready_to_train(scene, method_name, iterations, *often, *extra, seed=seed, skips=skips)
    return method, train(method, iterations)


def digest(method: Method) -> str:
    """A hash of every parameter of a method's models."""
    content = hashlib.sha256()
    for model in method.models().values():
        for _, tensor in model.gaussians.items():
            content.update(tensor.detach().numpy().tobytes())
    return content.hexdigest()

"""Short trainings of a method."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
import torch

from tdgbench.bench.setup import set_up
from tdgbench.scenes import Scene
from tdgbench.splats import Gaussians
from tdgbench.splats.gradients import Gradients
from tdgbench.training.checkpoint import Checkpoint
from tdgbench.training.loop import TrainingLog, train
from tdgbench.training.method import Method
from tdgbench.training.skips import Skips
from tdgbench.training.splat_model import SplatModel
from tdgbench.training.trainer import Trainer
from tests.helpers.configs import config

OFTEN = ("budget.density.start=20", "budget.density.every=20", "budget.sh_every=25")


def ready_to_train(
    scene: Scene,
    name: str,
    iterations: int,
    *overrides: str,
    seed: int = 0,
    skips: Skips | None = None,
    method: Method | None = None,
) -> Trainer:
    """Return a trainer of a method with the demo's budget. method: in the place of the configured one of that name."""
    cfg = config(
        f"method={name}", "prior=synthetic", "budget=demo", f"budget.iterations={iterations}", *overrides
    )  # fmt: skip
    cfg.seed = seed
    return set_up(cfg, scene, method=method, skips=skips, compiles=False).trainer


def trained(
    scene: Scene, method_name: str, iterations: int = 60, seed: int = 0, skips: Skips | None = None, **overrides
) -> tuple[Trainer, TrainingLog]:
    """Train a method for a while; return its trainer and the log."""
    extra = [f"{k}={v}" for k, v in overrides.items()]
    trainer = ready_to_train(scene, method_name, iterations, *OFTEN, *extra, seed=seed, skips=skips)
    return trainer, train(trainer)


def at_thermal_stage(scene: Scene, name: str, *overrides: str) -> tuple[Trainer, dict[str, Gaussians]]:
    """Train MFTG for 120 iterations; return its trainer, and its models after the 60 of the RGB stage."""
    trainer = ready_to_train(scene, name, 120, *OFTEN, *overrides)
    states = []

    def note(log: TrainingLog) -> None:
        if log.iterations == 60:
            states.append({part: model.copy() for part, model in trainer.gaussians.items()})

    train(trainer, after_iteration=note)
    return trainer, states[0]


class KilledError(Exception):
    """Ends a training as a signal would."""


def train_killed(make: Callable[[], Trainer], path: Path, stops: Sequence[int]) -> tuple[Trainer, TrainingLog]:
    """Train with a checkpoint after every iteration, killed after some; return the last trainer and its log."""
    for stop in (*stops, None):
        trainer, checkpoint = make(), Checkpoint(path, {"key": "k"}, 0.0)
        log = checkpoint.resume(trainer)
        assert checkpoint.notes == []

        def write(log: TrainingLog, checkpoint=checkpoint, stop=stop) -> None:
            checkpoint._next = 0.0  # however long writing takes
            checkpoint.write_if_due(log)
            if log.iterations == stop:
                raise KilledError

        if stop is not None:
            with pytest.raises(KilledError):
                train(trainer, after_iteration=write, log=log)
    return trainer, train(trainer, after_iteration=write, log=log)


def digest(trainer: Trainer) -> str:
    """Return a hash of every parameter of the Gaussians in training, which does not change later steps."""
    content = hashlib.sha256()
    for model in trainer.gaussians.values():
        for _, tensor in model.copy().items():
            content.update(tensor.detach().numpy().tobytes())
    return content.hexdigest()


def digest_of_all(trainer: Trainer) -> str:
    """Return a hash of everything that training changes."""
    for model in trainer.gaussians.values():
        model.optimizer.flush()
    return hashlib.sha256(b"".join(_bytes_of(trainer.state_dict()))).hexdigest()


def _bytes_of(state) -> Iterator[bytes]:
    """Yield the tensors, numbers and names of a state, in their order."""
    if isinstance(state, torch.Tensor):
        yield state.numpy().tobytes()
    elif isinstance(state, dict | list):
        for one in state.items() if isinstance(state, dict) else enumerate(state):
            yield repr(one[0]).encode()
            yield from _bytes_of(one[1])
    else:
        yield repr(state).encode()


def take_gradients(model: SplatModel) -> Gradients:
    """Return the sum of a model's gradients since its last step, which it forgets."""
    views, model._views = model._views, []
    return Gradients.total([view.gradients.compute() for view in views], len(model))

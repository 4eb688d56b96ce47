"""The training loop, shared by all methods."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import torch

from tdgbench.training.errors import EmptyModelError, NonFiniteError
from tdgbench.training.method import Context, Method, Step
from tdgbench.training.model import SplatModel
from tdgbench.training.settling import Settling
from tdgbench.training.skips.plateau import Plateau

LOG_LINES = 200


class Stopping(Protocol):
    """Decides when a training ends before its last iteration."""

    def reached(self, iteration: int, loss: float) -> bool:
        """Note an iteration's loss; True from the iteration on at which training may end."""

    def state_dict(self) -> dict[str, Any]:
        """Its state, as `torch.save` takes it."""

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore what `state_dict` returned."""


def stopping_of(method: Method, context: Context) -> Stopping | None:
    """What stops a training early, by the rules of its budget and the skips; None: nothing."""
    budget, skips = context.budget, context.skips
    if budget.settling is not None and skips.settling.allowed:
        return Settling(budget.settling, method, context)
    if budget.plateau is not None and skips.plateau.allowed:
        return Plateau(budget.plateau, len(context.scene.train))
    return None


@dataclass
class LogLine:
    """State of a training after an iteration. psnr: of the rendered training views, in dB, smoothed."""

    iteration: int
    seconds: float
    loss: float
    psnr: float
    gaussians: int
    terms: dict[str, float]


@dataclass
class TrainingLog:
    """Course of a training, in about 200 lines."""

    lines: list[LogLine] = field(default_factory=list)
    seconds: float = 0.0
    processor_seconds: float = 0.0  # of all threads of the process
    iterations: int = 0
    ended: bool = False
    resumed: list[int] = field(default_factory=list)  # iterations after which a checkpoint was loaded


def train(
    method: Method,
    iterations: int,
    on_line: Callable[[LogLine], None] | None = None,
    stopping: Stopping | None = None,
    on_step: Callable[[TrainingLog], None] | None = None,
    log: TrainingLog | None = None,
    on_model: Callable[[TrainingLog], None] | None = None,
) -> TrainingLog:
    """Train a method that is set up, for so many iterations or until `stopping` lets it end.

    The last iteration only measures: 3DGS, ThermalGaussian and TDg save and score the model before that iteration's
    density control and optimiser step. Training ends early once the models have recovered from density control.

    on_line is called with each log line. on_step is called after each iteration; on_model before its changes of the
    models, when they are as they would be saved. The clock is stopped during both. log: of earlier iterations, to
    resume after them.

    Raises NonFiniteError at the first loss, gradient or parameter that is not finite, and EmptyModelError when a model
    has no Gaussian.
    """
    log = log or TrainingLog()
    every = max(1, iterations // LOG_LINES)
    smoothed = log.lines[-1].psnr if log.lines else None
    clock = Clock(log)
    remaining = range(0) if log.ended else range(log.iterations + 1, iterations + 1)
    for iteration in remaining:
        models = method.models()
        for model in models.values():
            model.begin(iteration)
        step = method.step(iteration)
        loss = _finite_loss(step, models, iteration)
        may_end = stopping is not None and stopping.reached(iteration, step.terms.get("thermal", loss))
        ends = iteration == iterations or (may_end and all(m.has_recovered(iteration) for m in models.values()))
        if on_model is not None:
            log.iterations, log.ended = iteration, ends
            clock.stop()
            on_model(log)
            clock = Clock(log)
        if not ends:
            _update(step, models, iteration)
        if iteration % every == 0 or iteration == 1 or ends:
            for name, model in models.items():
                _check_parameters(name, model, iteration)
            psnr = _psnr(step)
            smoothed = psnr if smoothed is None else 0.8 * smoothed + 0.2 * psnr
            gaussians = sum(len(model) for model in models.values())
            clock.stop()
            line = LogLine(iteration, log.seconds, loss, smoothed, gaussians, step.terms)
            log.lines.append(line)
            if on_line is not None:
                on_line(line)
        log.iterations, log.ended = iteration, ends
        clock.stop()
        if on_step is not None:
            on_step(log)
            clock = Clock(log)
        if ends:
            break
    return log


class Clock:
    """Runs from its making on, and adds its time to that of a log."""

    def __init__(self, log: TrainingLog) -> None:
        self._log = log
        self._start = time.perf_counter() - log.seconds
        self._processor_start = time.process_time() - log.processor_seconds

    def stop(self) -> None:
        """Put the seconds so far into the log; the clock runs on."""
        self._log.seconds = time.perf_counter() - self._start
        self._log.processor_seconds = time.process_time() - self._processor_start


def _finite_loss(step: Step, models: dict[str, SplatModel], iteration: int) -> float:
    """Value of the loss. Raises NonFiniteError with the tensor that made it not finite."""
    loss = step.loss.item()
    if not math.isfinite(loss):
        for name, model in models.items():
            _check_parameters(name, model, iteration)
        raise NonFiniteError(iteration, _first_bad(step))
    return loss


def _update(step: Step, models: dict[str, SplatModel], iteration: int) -> None:
    """Backward pass, density control and Adam step."""
    step.loss.backward()
    for name, model in models.items():
        bad = model.finish(iteration)
        if bad is not None:
            raise NonFiniteError(iteration, f"gradient of {name} {bad}")
        if len(model) == 0:
            raise EmptyModelError(iteration, name)


@torch.no_grad()
def _psnr(step: Step) -> float:
    """PSNR of the thermal render at valid pixels, dB; finite for every finite render."""
    difference = step.thermal.image - step.target
    if step.valid is not None:
        difference = difference[step.valid]
    mse = difference.square().mean().item()
    if math.isinf(mse):  # the squares exceed float32
        mse = difference.double().square().mean().item()
    return -10 * math.log10(max(mse, 1e-12))


def _first_bad(step: Step) -> str:
    """Name of the first image, render or loss term that is not finite."""
    if not torch.isfinite(step.target).all():
        return "target image"
    for name, tensor in (("thermal render", step.thermal.image), ("depth render", step.thermal.depth)):
        if tensor is not None and not torch.isfinite(tensor).all():
            return name
    bad = [name for name, value in step.terms.items() if not math.isfinite(value)]
    return f"loss term {bad[0]}" if bad else "loss"


def _check_parameters(name: str, model: SplatModel, iteration: int) -> None:
    """Raise NonFiniteError with the first parameter that is not finite."""
    if not torch.isfinite(model.state.values.sum()):  # one pass in the usual case
        for parameter, tensor in model.gaussians.items():
            if not torch.isfinite(tensor).all():
                raise NonFiniteError(iteration, f"{name} {parameter}")

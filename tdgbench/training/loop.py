"""The loop that every method shares."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import torch

from tdgbench.training.errors import EmptyModelError, NonFiniteError
from tdgbench.training.method import Method, Step
from tdgbench.training.model import SplatModel
from tdgbench.training.skips.plateau import Plateau

LOG_LINES = 200


@dataclass
class LogLine:
    """Training at one moment. psnr is of the training view just rendered, smoothed."""

    iteration: int
    seconds: float
    loss: float
    psnr: float
    gaussians: int
    terms: dict[str, float]


@dataclass
class TrainingLog:
    """What happened so far, thinned to some 200 lines."""

    lines: list[LogLine] = field(default_factory=list)
    seconds: float = 0.0
    iterations: int = 0
    ended: bool = False
    resumed: list[int] = field(default_factory=list)  # iterations after which it was taken up from a checkpoint


def train(
    method: Method,
    iterations: int,
    on_line: Callable[[LogLine], None] | None = None,
    plateau: Plateau | None = None,
    on_step: Callable[[TrainingLog], None] | None = None,
    log: TrainingLog | None = None,
) -> TrainingLog:
    """Train a method that is set up, for so many iterations, or until its thermal loss is on a plateau.

    on_step is given the log after each step; the clock stands still meanwhile. log: that of the iterations which the
    method already has behind it, to go on from.

    Raises NonFiniteError at the first loss, gradient or parameter that is not finite, and EmptyModelError when no
    Gaussian is left.
    """
    log = log or TrainingLog()
    every = max(1, iterations // LOG_LINES)
    smoothed = log.lines[-1].psnr if log.lines else None
    start = time.perf_counter() - log.seconds
    left = range(0) if log.ended else range(log.iterations + 1, iterations + 1)
    for iteration in left:
        models = method.models()
        for model in models.values():
            model.begin(iteration)
        step = method.step(iteration)
        loss = step.loss.item()
        if not math.isfinite(loss):
            for name, model in models.items():
                _check_parameters(name, model, iteration)
            raise NonFiniteError(iteration, _first_bad(step))
        step.loss.backward()
        for name, model in models.items():
            bad = model.finish(iteration)
            if bad is not None:
                raise NonFiniteError(iteration, f"gradient of {name} {bad}")
            if len(model) == 0:
                raise EmptyModelError(iteration, name)
        ends = plateau is not None and plateau.reached(iteration, step.terms.get("thermal", loss))
        if iteration % every == 0 or iteration in (1, iterations) or ends:
            for name, model in models.items():
                _check_parameters(name, model, iteration)
            psnr = _psnr(step)
            smoothed = psnr if smoothed is None else 0.8 * smoothed + 0.2 * psnr
            line = LogLine(
                iteration=iteration,
                seconds=time.perf_counter() - start,
                loss=loss,
                psnr=smoothed,
                gaussians=sum(len(model) for model in models.values()),
                terms=step.terms,
            )
            log.lines.append(line)
            if on_line is not None:
                on_line(line)
        log.iterations, log.seconds = iteration, time.perf_counter() - start
        log.ended = ends or iteration == iterations
        if on_step is not None:
            on_step(log)
            start = time.perf_counter() - log.seconds
        if log.ended:
            break
    return log


@torch.no_grad()
def _psnr(step: Step) -> float:
    mse = (step.thermal.image - step.target).square().mean().item()
    return -10 * math.log10(max(mse, 1e-12))


def _first_bad(step: Step) -> str:
    """The image, render or loss term that is not finite."""
    if not torch.isfinite(step.target).all():
        return "target image"
    for name, tensor in (("thermal render", step.thermal.image), ("depth render", step.thermal.depth)):
        if tensor is not None and not torch.isfinite(tensor).all():
            return name
    bad = [name for name, value in step.terms.items() if not math.isfinite(value)]
    return f"loss term {bad[0]}" if bad else "loss"


def _check_parameters(name: str, model: SplatModel, iteration: int) -> None:
    if not torch.isfinite(model.state.values.sum()):  # one pass; who it was is asked only when it must be
        for parameter, tensor in model.gaussians.items():
            if not torch.isfinite(tensor).all():
                raise NonFiniteError(iteration, f"{name} {parameter}")

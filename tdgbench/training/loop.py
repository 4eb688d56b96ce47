"""The training loop, shared by all methods."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from torch import Tensor

from tdgbench.splats.cpu.losses.photometric import keep_prepared
from tdgbench.splats.transfer import start_copy_to_host
from tdgbench.training.method import Step
from tdgbench.training.part import NonFiniteError, Part, Stopping, TrainingError
from tdgbench.training.trainer import Trainer

LOG_LINES = 200


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
    trainer: Trainer,
    on_log_line: Callable[[LogLine], None] | None = None,
    after_iteration: Callable[[TrainingLog], None] | None = None,
    log: TrainingLog | None = None,
    before_update: Callable[[TrainingLog], None] | None = None,
) -> TrainingLog:
    """Train stage after stage, each for its budget's iterations or until its rule lets it end.

    In the last iteration nothing is updated, since 3DGS, ThermalGaussian and TDg save and score the model before that
    iteration's density control and optimiser step. A stage may end early, but not before its parts have recovered from
    the last densification or opacity reset.

    on_log_line is called with each log line, before_update in each iteration before the parts change, after_iteration
    at its end; the clock is stopped during the last two. log: of earlier iterations, to resume after them. The log of a
    method that does not train is empty.

    On a GPU, loss and gradients are checked late, so that the host waits for the number of pairs alone: after the next
    step has been rendered (`Pending`), and before a line of the log, a checkpoint, `before_update` and a stage's end.

    Raises NonFiniteError at the first loss, gradient or parameter that is not finite, and EmptyModelError when a model
    has no Gaussian.
    """
    log = log or TrainingLog()
    log.ended = log.ended or not trainer.method.trains
    loop = _Loop(trainer, log, on_log_line, after_iteration, before_update)
    try:
        with trainer.pending.made_at_end():
            while not log.ended:
                loop.iterate()
    except TrainingError as error:
        error.iteration += trainer.stage_start  # of the whole training, as in the log
        raise
    return log


@dataclass
class _Loop:
    """The iterations of a training, and the functions that it calls."""

    trainer: Trainer
    log: TrainingLog
    on_log_line: Callable[[LogLine], None] | None
    after_iteration: Callable[[TrainingLog], None] | None
    before_update: Callable[[TrainingLog], None] | None

    def __post_init__(self) -> None:
        keep_prepared(_gaussians(self.trainer))
        self.clock = Clock(self.log)
        self.line_every = max(1, self.trainer.whole_context.budget.iterations // LOG_LINES)

    def iterate(self) -> None:
        """Make the next iteration, and start the next stage if this one ends."""
        trainer, log = self.trainer, self.log
        iteration = log.iterations - trainer.stage_start + 1  # within the stage
        for part in trainer.parts.values():
            part.begin(iteration)
        step = trainer.stage.step(iteration)
        if not isinstance(step, Step):
            raise TypeError(f"the method's step returned {type(step).__name__}; it must return a Step")
        if not step.loss.requires_grad:
            raise TypeError("the loss of the method's step has no gradient: is it detached, or made under no_grad?")
        ends_stage = _ends(trainer, iteration, _checked_loss(step, trainer, iteration))
        log.iterations += 1
        log.ended = ends_stage and trainer.is_last_stage
        if self.before_update is not None:
            trainer.pending.read()
            with self.clock.stopped():
                self.before_update(log)
        if not ends_stage:
            _update(step, trainer, iteration)
        if log.iterations % self.line_every == 0 or log.iterations == 1 or ends_stage:
            self._add_line(step, iteration)
        self.clock.write_times()
        if ends_stage:
            with self.clock.stopped():  # set-up of the next stage, as that of the first one
                trainer.advance(iteration)
        if self.after_iteration is not None:
            with self.clock.stopped():
                self.after_iteration(log)

    def _add_line(self, step: Step, iteration: int) -> None:
        """Check the parameters, and add a line to the log."""
        self.trainer.pending.read()
        _check_parameters(self.trainer.parts, iteration)
        self.clock.write_times()
        line = _line(self.log, step, self.trainer)
        self.log.lines.append(line)
        keep_prepared(line.gaussians)
        if self.on_log_line is not None:
            self.on_log_line(line)


def _checked_loss(step: Step, trainer: Trainer, iteration: int) -> float | Tensor:
    """Check that the loss is finite, on a GPU later; return the loss that stopping rules watch."""
    watched = step.terms.get("thermal", step.loss)
    if trainer.on_gpu:
        trainer.pending.read()
        read = start_copy_to_host(step.loss)
        trainer.pending.add(lambda: _check_loss(read().item(), step, iteration))
        return watched.detach().double() if isinstance(watched, Tensor) else watched
    loss = step.loss.item()
    if not math.isfinite(loss):
        _check_parameters(trainer.parts, iteration)
    _check_loss(loss, step, iteration)
    return watched.item() if isinstance(watched, Tensor) else watched


def _check_loss(loss: float, step: Step, iteration: int) -> None:
    """Raise NonFiniteError, which names what is not finite in a step, if its loss is not."""
    if not math.isfinite(loss):
        raise NonFiniteError(iteration, _first_bad(step, step.numbers()[1]))


def _ends(trainer: Trainer, iteration: int, loss: Any) -> bool:
    """Return whether the stage ends with an iteration. loss: a number, or a scalar of a GPU."""
    rules = [part for part in (trainer.stopping, *trainer.parts.values()) if isinstance(part, Stopping)]
    if trainer.on_gpu and any(rule.reads_loss for rule in rules):
        loss = float(loss)
        trainer.pending.read()
    reached = [rule.reached(iteration, loss) for rule in rules]  # all of them take the loss
    if iteration >= trainer.context.budget.iterations:
        return True
    if not any(reached):
        return False
    if not all(one.is_at_full_resolution or one.settled_at for one in trainer.context.curricula.values()):
        return False  # another rule's end is no reason to leave out the images' last pixels
    may_end = [rule.lets_end(iteration) for rule in rules]
    return all(may_end) and all(part.has_recovered(iteration) for part in trainer.parts.values())


def _line(log: TrainingLog, step: Step, trainer: Trainer) -> LogLine:
    """Return the line of an iteration; its PSNR is smoothed with those of the lines before in the same stage."""
    loss, terms = step.numbers()
    psnr = step.psnr()
    is_first = not log.lines or log.lines[-1].iteration <= trainer.stage_start
    smoothed = psnr if is_first else 0.8 * log.lines[-1].psnr + 0.2 * psnr
    return LogLine(log.iterations, log.seconds, loss, smoothed, _gaussians(trainer), terms)


def _gaussians(trainer: Trainer) -> int:
    return sum(len(model) for model in trainer.gaussians.values())


class Clock:
    """A stopwatch that starts when it is made and continues the times of a log."""

    def __init__(self, log: TrainingLog) -> None:
        self._log = log
        self._start()

    def _start(self) -> None:
        self._began = time.perf_counter() - self._log.seconds
        self._processor_began = time.process_time() - self._log.processor_seconds

    def write_times(self) -> None:
        """Write the times so far to the log."""
        self._log.seconds = time.perf_counter() - self._began
        self._log.processor_seconds = time.process_time() - self._processor_began

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Write the times so far to the log, and start again afterwards."""
        self.write_times()
        yield
        self._start()


def _update(step: Step, trainer: Trainer, iteration: int) -> None:
    """Do the backward pass and let every part change by its gradients."""
    step.loss.backward()
    for name, part in trainer.parts.items():
        bad = part.step(iteration)
        if bad is not None:
            if callable(bad):
                trainer.pending.add(partial(_check_gradient, bad, name, iteration))
            else:
                raise NonFiniteError(iteration, f"gradient of {name} {bad}")


def _check_gradient(read: Callable[[], str | None], part: str, iteration: int) -> None:
    """Raise NonFiniteError if what is read is the name of a parameter of a part."""
    bad = read()
    if bad is not None:
        raise NonFiniteError(iteration, f"gradient of {part} {bad}")


def _first_bad(step: Step, terms: Mapping[str, float]) -> str:
    """Return the name of the first image, render or loss term that is not finite."""
    if not torch.isfinite(step.target).all():
        return "target image"
    for name, tensor in (("render", step.render.image), ("depth render", step.render.depth)):
        if tensor is not None and not torch.isfinite(tensor).all():
            return name
    bad = [name for name, value in terms.items() if not math.isfinite(value)]
    return f"loss term {bad[0]}" if bad else "loss"


def _check_parameters(parts: Mapping[str, Part], iteration: int) -> None:
    """Raise NonFiniteError with the first parameter of a part that is not finite."""
    for name, part in parts.items():
        bad = part.not_finite()
        if bad is not None:
            raise NonFiniteError(iteration, f"{name} {bad}")

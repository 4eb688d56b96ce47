"""Rules that end a training early: by the PSNR of held-out training views, or by the loss of the others."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import torch

from tdgbench.scenes import View
from tdgbench.training.budget import PlateauRule, SettlingRule
from tdgbench.training.curriculum import Curriculum
from tdgbench.training.part import Part, State, Stopping

MIN_MSE = 1e-10
IN_A_ROW = 2  # resolutions that are no better: one alone may still suffer from the change


def hold_out(rule: SettlingRule, views: list[View]) -> list[View]:
    """Return the training views to hold out by a rule, evenly spread."""
    if len(views) < 4 * rule.fewest:
        return []
    return spread(views, min(max(rule.fewest, round(rule.share * len(views))), rule.most, len(views) // 4))


def spread(views: list[View], count: int) -> list[View]:
    """Return a number of views, evenly spread."""
    return [views[int((i + 0.5) * len(views) / count)] for i in range(count)]


class LastWindow(NamedTuple):
    """The last window of checks, compared with the one before it."""

    checks: int
    psnrs: np.ndarray  # (V,) of its views, dB
    gain: float  # on the window before, mean over views, dB
    standard_error: float  # of the gain, from the spread of the checks in both windows, dB


def last_window(rule: SettlingRule, psnrs: list[list[float]], fewest: int) -> LastWindow | None:
    """Return the last window, of `fewest` checks or more; None while there are too few checks."""
    size = max(fewest, math.ceil(rule.window * len(psnrs)))
    if len(psnrs) < 2 * size:
        return None
    last, before = np.array(psnrs[-size:]), np.array(psnrs[-2 * size : -size])
    gain = float(last.mean() - before.mean())
    spread_of = [float(np.var(window.mean(axis=1), ddof=1)) if size > 1 else 0.0 for window in (last, before)]
    return LastWindow(size, last.mean(axis=0), gain, math.sqrt(sum(spread_of) / size))


def psnr_of_error(error: np.ndarray) -> float:
    """Return the PSNR (dB) of the difference between a render and its image, of any shape."""
    return -10 * math.log10(max(float(np.square(error).mean(dtype=np.float64)), MIN_MSE))


class Settling(Stopping):
    """Raises the resolution, lowers the learning rates and ends a training, by the PSNR of held-out views."""

    reads_loss = False

    def __init__(
        self,
        rule: SettlingRule,
        iterations: int,
        curriculum: Curriculum,
        parts: Mapping[str, Part],
        errors: Callable[[View], np.ndarray],
    ) -> None:
        """parts: of the stage that runs. errors: returns the errors (n, C) of a view's render at n valid pixels."""
        self.rule, self.iterations, self.curriculum = rule, iterations, curriculum
        self.parts, self.errors = parts, errors
        for part in parts.values():  # the tail of an earlier stage slowed those that it had, too
            part.scale_learning_rates(1.0)
        self._scale = curriculum.scale
        self._psnrs: list[list[float]] = []  # of the checks at this resolution, by view
        self._stalls = 0  # of the last checks, in a row
        self._best_scale, self._best_psnrs = 0, list[float]()  # of the resolutions before, at its end; 0: none
        self._no_better = 0  # resolutions in a row since then

    def state_dict(self) -> State:
        names = ("_scale", "_psnrs", "_stalls", "_best_scale", "_best_psnrs", "_no_better")
        return {name.strip("_"): getattr(self, name) for name in names}

    def load_state_dict(self, saved: State) -> None:
        for name, value in saved.items():
            setattr(self, f"_{name}", list(value) if isinstance(value, list) else value)
        if self.curriculum.settled_at:
            self._stop_growth()

    def reached(self, iteration: int, loss: float) -> bool:
        curriculum = self.curriculum
        if not curriculum.settled_at:
            scale = self._settles(iteration)
            if scale is None:
                return False
            curriculum.settle(scale)
            self._stop_growth()
        length = max(1, round(self.rule.tail * curriculum.settled_at))
        progress = min(1.0, (iteration - curriculum.settled_at) / length)
        for part in self.parts.values():
            part.scale_learning_rates(self.rule.slowdown**progress)
        curriculum.has_ended = progress == 1.0
        return curriculum.has_ended

    def _stop_growth(self) -> None:
        for part in self.parts.values():
            part.stop_growth(self.curriculum.settled_at)

    def _settles(self, iteration: int) -> int | None:
        """Return the scale at which the training settles now; None if it does not."""
        rule, curriculum = self.rule, self.curriculum
        if iteration >= rule.latest(self.iterations):
            return 1
        if iteration % rule.every or not curriculum.held_out:
            return None
        if curriculum.scale != self._scale:  # by the schedule
            self._leave_resolution()
        is_full = curriculum.is_at_full_resolution
        if is_full and iteration <= rule.last_after:
            return None
        self._psnrs.append(self._held_out_psnrs())
        last = last_window(rule, self._psnrs, rule.last_checks if is_full else rule.checks)
        if last is None:
            return None
        self._stalls = 0 if last.gain + is_full * last.standard_error >= rule.gain else self._stalls + 1
        if not self._stalls or (is_full and last.checks + self._stalls - 1 < rule.stalled_checks):
            return None
        is_last = is_full or self._no_better >= IN_A_ROW - 1
        if is_last and not self._is_best(last.psnrs):
            return self._best_scale
        if is_full:
            return curriculum.scale
        curriculum.advance()
        self._leave_resolution()
        return None

    def _is_best(self, psnrs: np.ndarray) -> bool:
        """Return whether held-out views (V,) are better than with the best resolution so far."""
        return not self._best_scale or float(np.mean(psnrs - self._best_psnrs)) >= self.rule.gain

    def _leave_resolution(self) -> None:
        """Compare the last resolution with the best one so far, and start with the current one."""
        if self._psnrs:
            reached = np.mean(self._psnrs[-self.rule.checks :], axis=0)
            if self._is_best(reached):
                self._best_scale, self._best_psnrs, self._no_better = self._scale, reached.tolist(), 0
            else:
                self._no_better += 1
        self._scale, self._psnrs, self._stalls = self.curriculum.scale, [], 0

    @torch.no_grad()
    def _held_out_psnrs(self) -> list[float]:
        """Return the PSNR of the held-out views over valid pixels, at full resolution, dB."""
        return [psnr_of_error(self.errors(view)) for view in self.curriculum.held_out]


class AllSettled(Stopping):
    """Ends a training of models of several modalities, each of which its own held-out images end."""

    reads_loss = False

    def __init__(self, rules: Mapping[str, Settling]) -> None:
        """rules: by modality."""
        self.rules = rules

    def state_dict(self) -> State:
        return {name: rule.state_dict() for name, rule in self.rules.items()}

    def load_state_dict(self, saved: State) -> None:
        for name, rule in self.rules.items():
            rule.load_state_dict(saved[name])

    def reached(self, iteration: int, loss: float) -> bool:
        reached = [rule.reached(iteration, loss) for rule in self.rules.values()]  # all of them look
        return all(reached)


class Plateau(Stopping):
    """Detects a plateau of the loss by a rule. On a GPU, the device adds the losses up; the host reads their sums."""

    reads_loss = False

    def __init__(self, rule: PlateauRule, views: int) -> None:
        """views: number of training views."""
        self.rule, self.views = rule, views
        self._sum: float | torch.Tensor = 0.0
        self._count = 0
        self._best, self._without = float("inf"), 0
        self._reached = False

    def state_dict(self) -> State:
        names = ("_count", "_best", "_without", "_reached")
        return {"_sum": float(self._sum), **{name: getattr(self, name) for name in names}}

    def load_state_dict(self, saved: State) -> None:
        vars(self).update(saved)

    def reached(self, iteration: int, loss: float | torch.Tensor) -> bool:
        if self._reached:
            return True
        if iteration <= self.rule.after:
            return False
        self._sum, self._count = self._sum + loss, self._count + 1
        if self._count < self.rule.epochs * self.views:
            return False
        mean, self._sum, self._count = float(self._sum) / self._count, 0.0, 0
        if mean < self._best * (1 - self.rule.gain):
            self._without = 0
        else:
            self._without += 1
        self._best = min(self._best, mean)
        self._reached = self._without >= self.rule.patience
        return self._reached

"""The rule for settling: end a training when the PSNR of held-out training views no longer rises."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt

from tdgbench.scenes import View
from tdgbench.training.curriculum import Curriculum, evenly_spread
from tdgbench.training.part import Part, State, Stopping
from tdgbench.training.rule import Rule, Watched
from tdgbench.training.skips import Finished, Skip

IN_A_ROW = 2  # resolutions that are no better: one alone may still suffer from the change


@dataclass(frozen=True)
class SettlingRule(Rule):
    """End a training when the PSNR of held-out views, training views that it does not train on, no longer rises.

    Every `every` iterations the held-out views are rendered: a check. A window is a share of the checks at the current
    resolution. The training stalls when the last window gains less than `gain` on the window before. At the full
    resolution, a window stalls only if its gain plus one standard error is below `gain`, so that noise hides no gain.
    Nor does it stall while the Gaussians grow by more than `most_growth`: views agree that something is missing. At the
    full resolution, no check is made until `full_after`, since nothing has grown.

    A stall below the full resolution ends that resolution. The training settles after two resolutions in a row without
    a new best, or at the full resolution once the windows of stalls in a row cover `stalled_checks`. It settles at the
    best resolution: from then on the held-out views are trained on as well, no Gaussians are added, and all learning
    rates fall log-linearly for `tail`. One that never stalls settles so that the tail ends it.
    """

    ends_training = True
    watches_modalities = True

    share: Annotated[float, Field(gt=0, le=0.25)]  # of the training views, which is held out
    fewest: PositiveInt  # held-out views; none are held out of less than four times as many training views
    most: PositiveInt  # held-out views
    every: PositiveInt  # iterations between checks
    checks: PositiveInt  # in a window below the full resolution, at least
    full_checks: PositiveInt  # in a window at the full resolution, at least
    stalled_checks: PositiveInt  # at the full resolution, covered by the windows of stalls in a row
    most_growth: PositiveFloat  # of the number of Gaussians within `stalled_checks` checks, for a stall
    full_after: NonNegativeInt  # iterations before the first check at the full resolution
    window: Annotated[float, Field(gt=0, le=0.5)]  # share of the checks at a resolution that is in a window
    gain: PositiveFloat  # dB, the mean over held-out views
    tail: PositiveFloat  # iterations after settling, as a share of those before
    slowdown: Annotated[float, Field(gt=0, le=1)]  # of all learning rates at the end

    def latest(self, iterations: int) -> int:
        """Return the last iteration at which a training of so many iterations settles."""
        return max(1, int(iterations / (1 + self.tail)))

    def held_out(self, views: list[View]) -> list[View]:
        """Return evenly spread training views; none of less than four times `fewest`."""
        if len(views) < 4 * self.fewest:
            return []
        return evenly_spread(views, min(max(self.fewest, round(self.share * len(views))), self.most, len(views) // 4))

    def stopping(self, stage: Watched) -> Stopping:
        return Settling(self, stage.iterations, stage.curriculum, stage.parts, stage.psnr_of)

    def account(self, skip: Skip, training: Finished) -> None:
        is_early = any(0 < curriculum.settled_at < self.latest(length) for curriculum, length in training.curricula)
        held_out = len(training.curricula[0][0].held_out)
        if not held_out:
            reason = "too few training views to hold some out"
        elif not is_early:
            reason = f"{held_out} held-out views went on getting better"
        else:
            reason = f"{held_out} held-out views no longer gained from window to window"
        skip.decide(is_early and training.remaining > 0, reason, training.left_out)


class Settling(Stopping):
    """Raises the resolution, lowers the learning rates and ends a training, by the PSNR of held-out views."""

    reads_loss = False
    changing = ("_scale", "_psnrs", "_counts", "_stalls", "_best_scale", "_best_psnrs", "_no_better")

    def __init__(
        self,
        rule: SettlingRule,
        iterations: int,
        curriculum: Curriculum,
        parts: Mapping[str, Part],
        psnr_of: Callable[[View], float],
    ) -> None:
        """parts: of the stage that runs. psnr_of: renders a view at full resolution and returns its PSNR, dB."""
        self.rule, self.iterations, self.curriculum = rule, iterations, curriculum
        self.parts, self.psnr_of = parts, psnr_of
        for part in parts.values():  # the tail of an earlier stage slowed those that it had, too
            part.set_slowdown(1.0)
        self._scale = curriculum.scale
        self._psnrs: list[list[float]] = []  # of the checks at this resolution, by view
        self._counts: list[int] = []  # of Gaussians at these checks
        self._stalls = 0  # of the last checks, in a row
        self._best_scale, self._best_psnrs = 0, list[float]()  # of the resolutions before, at its end; 0: none
        self._no_better = 0  # resolutions in a row since then

    def load_state_dict(self, saved: State) -> None:
        super().load_state_dict(saved)
        if self.curriculum.settled_at:
            self._stop_growth()

    def reached(self, iteration: int, loss: float) -> bool:
        if not self.curriculum.settled_at:
            if iteration >= self.rule.latest(self.iterations):
                self._settle(1, "the last iterations are left, and held-out views may still gain")
            elif iteration % self.rule.every == 0 and self.curriculum.held_out:
                self._check(iteration)
        if self.curriculum.settled_at:
            self._slow_down(iteration)
        return self.curriculum.has_ended

    @property
    def ends_at(self) -> int | None:
        settled_at = self.curriculum.settled_at
        return settled_at + self._tail if settled_at else None

    @property
    def _tail(self) -> int:
        """Iterations after settling."""
        return max(1, round(self.rule.tail * self.curriculum.settled_at))

    def _check(self, iteration: int) -> None:
        """Render the held-out views; if they stall, go on to the next resolution or settle."""
        curriculum, rule = self.curriculum, self.rule
        if curriculum.scale != self._scale:  # by the schedule
            self._leave_resolution()
        is_full = curriculum.is_at_full_resolution
        if is_full and iteration <= rule.full_after:
            return
        self._psnrs.append([self.psnr_of(view) for view in curriculum.held_out])
        self._counts.append(sum(part.gaussian_count for part in self.parts.values()))
        curriculum.checks.append([iteration, curriculum.scale, round(float(np.mean(self._psnrs[-1])), 3)])
        last = last_window(rule, self._psnrs, rule.full_checks if is_full else rule.checks)
        if last is None:
            return
        goes_on = last.gain + is_full * last.standard_error >= rule.gain or (is_full and self._is_growing)
        self._stalls = 0 if goes_on else self._stalls + 1
        if not self._stalls or (is_full and last.checks + self._stalls - 1 < rule.stalled_checks):
            return
        is_last = is_full or self._no_better >= IN_A_ROW - 1
        if is_last and not self._is_best(last.psnrs):
            self._settle(self._best_scale, f"larger images than 1/{self._best_scale} gained less than {rule.gain:g} dB")
        elif is_full:
            stalled = last.checks + self._stalls - 1
            self._settle(curriculum.scale, f"in {stalled} checks, held-out views gained less than {rule.gain:g} dB")
        else:
            curriculum.advance()
            self._leave_resolution()

    def _settle(self, scale: int, reason: str) -> None:
        """Begin the tail, at a scale."""
        self.curriculum.settle(scale, reason)
        self._stop_growth()

    def _slow_down(self, iteration: int) -> None:
        """Set the learning rates of an iteration of the tail; end the training after the last one."""
        progress = min(1.0, (iteration - self.curriculum.settled_at) / self._tail)
        for part in self.parts.values():
            part.set_slowdown(self.rule.slowdown**progress)
        self.curriculum.has_ended = progress == 1.0

    def _stop_growth(self) -> None:
        for part in self.parts.values():
            part.stop_growth(self.curriculum.settled_at)

    @property
    def _is_growing(self) -> bool:
        """Whether there are many more Gaussians than `stalled_checks` checks before, or at the first check since."""
        before = self._counts[-1 - min(self.rule.stalled_checks, len(self._counts) - 1)]
        return self._counts[-1] > (1 + self.rule.most_growth) * before

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
        self._scale, self._psnrs, self._counts, self._stalls = self.curriculum.scale, [], [], 0


class AllSettled(Stopping):
    """Ends a training of models of several modalities, each of which its own held-out images end."""

    reads_loss = False

    def __init__(self, rules: Mapping[str, Stopping]) -> None:
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

    @property
    def ends_at(self) -> int | None:
        ends = [rule.ends_at for rule in self.rules.values()]
        return None if None in ends else max(end for end in ends if end is not None)


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
    variances = [float(np.var(window.mean(axis=1), ddof=1)) if size > 1 else 0.0 for window in (last, before)]
    return LastWindow(size, last.mean(axis=0), gain, math.sqrt(sum(variances) / size))

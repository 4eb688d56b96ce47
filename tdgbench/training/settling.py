"""The rule for settling: end a training when the PSNR of held-out training views no longer rises."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveFloat, PositiveInt

from tdgbench.scenes import View
from tdgbench.training.curriculum import Curriculum, evenly_spread
from tdgbench.training.part import Part, State, Stopping
from tdgbench.training.rule import Rule, Watched
from tdgbench.training.skips import Finished, Skip

CONFIDENCE = 0.9  # of the interval of a slope: 95 % lie below its upper bound, if errors of checks are independent
IN_A_ROW = 2  # resolutions that are no better: one alone may still suffer from the change


@dataclass(frozen=True)
class SettlingRule(Rule):
    """End a training when the PSNR of held-out views, training views that it does not train on, no longer rises.

    Every `every` iterations the held-out views are rendered: a check. Below the full resolution the training stalls
    when the last `checks` checks gain less than `gain` on as many before. At the full resolution, PSNR is taken to rise
    by as much whenever the iterations double. That slope is the median of the slopes between all pairs of the checks
    since `since` of the iterations so far, at least `slope_checks` (Theil and Sen), which a few outliers hardly move.
    The training stalls when `horizon` further iterations would gain less than `gain` with the upper bound of the
    slope's 90 % interval, so that noise seldom hides a gain. Nor does it stall there while the Gaussians grow by more
    than `most_growth`: views agree that something is missing, and gain some checks later. At the full resolution, no
    check is made until `full_after`, since nothing has grown.

    A stall below the full resolution ends that resolution. The training settles after two resolutions in a row without
    a new best, or at a stall at the full resolution. It settles at the best resolution: from then on the held-out views
    are trained on as well, no Gaussians are added, and all learning rates fall log-linearly for `tail`. One that never
    stalls settles so that the tail ends it.
    """

    ends_training = True
    watches_modalities = True

    share: Annotated[float, Field(gt=0, le=0.25)]  # of the training views, which is held out
    fewest: PositiveInt  # held-out views; none are held out of less than four times as many training views
    most: PositiveInt  # held-out views
    every: PositiveInt  # iterations between checks
    checks: PositiveInt  # that are compared with as many before, below the full resolution
    slope_checks: Annotated[int, Field(ge=2)]  # at the full resolution, at least, for a slope; two have no interval
    since: Annotated[float, Field(ge=0, le=0.9)]  # of the iterations so far; earlier checks count for no slope
    horizon: PositiveInt  # further iterations, which must promise `gain`
    most_growth: PositiveFloat  # of the number of Gaussians within `growth_checks`, for a stall at the full resolution
    growth_checks: PositiveInt  # checks
    full_after: NonNegativeInt  # iterations before the first check at the full resolution: the first round of growth
    gain: PositiveFloat  # dB, the mean over held-out views; a smaller gain is a stall
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
        reasons = "; ".join(dict.fromkeys(c.reason for c, _ in training.curricula if c.reason))
        reason = f"{held_out} held-out view{'s' * (held_out != 1)}: {reasons}"
        none = "too few training views to hold some out"
        skip.decide(is_early and training.remaining > 0, reason if held_out else none, training.left_out)


class Settling(Stopping):
    """Raises the resolution, lowers the learning rates and ends a training, by the PSNR of held-out views."""

    reads_loss = False
    changing = ("_scale", "_checks", "_best_scale", "_best_psnr", "_no_better")

    def __init__(
        self,
        rule: SettlingRule,
        iterations: int,
        curriculum: Curriculum,
        parts: Mapping[str, Part],
        psnr_of: Callable[[View], float],
    ) -> None:
        """parts: of the stage that runs. psnr_of: renders a view at full resolution and returns its PSNR, dB."""
        import scipy.stats  # noqa: F401  # takes half a second; only trainings with this rule need it

        self.rule, self.iterations, self.curriculum = rule, iterations, curriculum
        self.parts, self.psnr_of = parts, psnr_of
        for part in parts.values():  # the tail of an earlier stage slowed those that it had, and ended their growth
            part.set_slowdown(1.0)
            part.stop_growth(None)
        self._scale = curriculum.scale
        self._checks: list[tuple[int, float, int]] = []  # at this resolution: iteration, mean PSNR, Gaussians
        self._best_scale, self._best_psnr = 0, 0.0  # of the resolutions before, at its end; 0: none
        self._no_better = 0  # resolutions in a row since then

    def load_state_dict(self, saved: State) -> None:
        super().load_state_dict(saved)
        if self.curriculum.settled_at:
            self._stop_growth()

    def reached(self, iteration: int, loss: float) -> bool:
        if not self.curriculum.settled_at:
            if iteration >= self.rule.latest(self.iterations):
                seen = "held-out views may still gain" if self.curriculum.checks else "no held-out view was looked at"
                left = (self.iterations - iteration) / iteration
                self._settle(1, f"the last iterations are left, and {seen}", left)
            elif iteration % self.rule.every == 0 and self.curriculum.held_out:
                self._check(iteration)
        if self.curriculum.settled_at:
            self._slow_down(iteration)
        return self.curriculum.has_ended

    def lets_end(self, iteration: int) -> bool:
        if not self.curriculum.settled_at:
            self._settle(self.curriculum.scale, "another rule ended the training")
        return self.curriculum.has_ended

    @property
    def ends_at(self) -> int | None:
        settled_at = self.curriculum.settled_at
        return settled_at + self.curriculum.tail if settled_at else None

    def _check(self, iteration: int) -> None:
        """Render the held-out views; if they stall, go on to the next resolution or settle."""
        curriculum, rule = self.curriculum, self.rule
        if curriculum.scale != self._scale:  # by the schedule
            self._leave_resolution()
        if any(part.was_reset(iteration) for part in self.parts.values()):
            return
        is_full = curriculum.is_at_full_resolution
        if is_full and iteration <= rule.full_after:
            return
        psnrs = [psnr for psnr in map(self.psnr_of, curriculum.held_out) if not math.isnan(psnr)]  # no valid pixel
        if not psnrs:
            return
        psnr, gaussians = float(np.mean(psnrs)), sum(part.gaussian_count for part in self.parts.values())
        self._checks.append((iteration, psnr, gaussians))
        curriculum.checks.append([iteration, curriculum.scale, round(psnr, 3)])
        if not (self._stalls_at_full() if is_full else self._stalls_below()):
            return
        if any(part.is_filling(iteration) for part in self.parts.values()):
            return
        is_last = is_full or self._no_better >= IN_A_ROW - 1
        if is_last and not self._is_best(self._last_psnr()):
            self._settle(self._best_scale, f"larger images than 1/{self._best_scale} gained less than {rule.gain:g} dB")
        elif is_full:
            self._settle(curriculum.scale, f"{rule.horizon} more iterations would gain less than {rule.gain:g} dB")
        else:
            curriculum.advance()
            self._leave_resolution()

    def _last_psnr(self, before: int = 0) -> float:
        """Return the mean of the last checks at this resolution, dB; or of as many that have `before` after them."""
        end = len(self._checks) - before
        return float(np.mean([psnr for _, psnr, _ in self._checks[max(0, end - self.rule.checks) : end]]))

    def _stalls_below(self) -> bool:
        """Return whether held-out views stall below the full resolution."""
        size = self.rule.checks
        return len(self._checks) >= 2 * size and self._last_psnr() - self._last_psnr(before=size) < self.rule.gain

    def _stalls_at_full(self) -> bool:
        """Return whether held-out views stall at the full resolution."""
        from scipy.stats import theilslopes  # imported by the constructor, before the clock

        rule, now = self.rule, self._checks[-1][0]
        iterations, psnrs, _ = np.array([check for check in self._checks if check[0] > rule.since * now]).T
        if len(psnrs) < rule.slope_checks or self._is_growing:
            return False
        slope = theilslopes(psnrs, np.log2(iterations), CONFIDENCE).high_slope
        return bool(slope * math.log2(1 + rule.horizon / now) < rule.gain)

    def _settle(self, scale: int, reason: str, tail: float | None = None) -> None:
        """Begin the tail, at a scale. tail: share of the iterations so far; None: the rule's."""
        self.curriculum.settle(scale, self.rule.tail if tail is None else tail, reason)
        self._stop_growth()

    def _slow_down(self, iteration: int) -> None:
        """Set the learning rates of an iteration of the tail; end the training after the last one."""
        progress = min(1.0, (iteration - self.curriculum.settled_at) / self.curriculum.tail)
        for part in self.parts.values():
            part.set_slowdown(self.rule.slowdown**progress)
        self.curriculum.has_ended = progress == 1.0

    def _stop_growth(self) -> None:
        for part in self.parts.values():
            part.stop_growth(self.curriculum.settled_at)

    @property
    def _is_growing(self) -> bool:
        """Whether there are many more Gaussians than `growth_checks` checks before, or at the first check since."""
        counts = [count for _, _, count in self._checks[-1 - self.rule.growth_checks :]]
        return counts[-1] > (1 + self.rule.most_growth) * counts[0]

    def _is_best(self, psnr: float) -> bool:
        """Return whether held-out views are better, dB, than with the best resolution so far."""
        return not self._best_scale or psnr - self._best_psnr >= self.rule.gain

    def _leave_resolution(self) -> None:
        """Compare the last resolution with the best one so far, and start with the current one."""
        if self._checks:
            if self._is_best(self._last_psnr()):
                self._best_scale, self._best_psnr, self._no_better = self._scale, self._last_psnr(), 0
            else:
                self._no_better += 1
        self._scale, self._checks = self.curriculum.scale, []


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

    def lets_end(self, iteration: int) -> bool:
        may_end = [rule.lets_end(iteration) for rule in self.rules.values()]
        return all(may_end)

    @property
    def ends_at(self) -> int | None:
        ends = [rule.ends_at for rule in self.rules.values()]
        return None if None in ends else max(end for end in ends if end is not None)

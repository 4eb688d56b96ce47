"""What held-out training views say about a training: when it needs more pixels, and when it settles and ends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import torch
from pydantic import Field, PositiveFloat, PositiveInt

from tdgbench.scenes import View

if TYPE_CHECKING:
    from tdgbench.training.method import Context, Method

MIN_MSE = 1e-10
IN_A_ROW = 2  # resolutions that are no better: one alone may still suffer from the change


@dataclass(frozen=True)
class SettlingRule:
    """A training stalls once its held-out training views gain less than `gain` from one window of checks to the next.

    A window is a share of the checks at the current resolution. A training that stalls below the full resolution goes
    on to the next one. At the full one, or after two in a row that are no better than the best, it settles at the best:
    the held-out views are trained on as well, nothing grows any more, and all learning rates fall log-linearly for a
    while. A training that never settles does the same at its end, at the full resolution.
    """

    share: Annotated[float, Field(gt=0, le=0.25)]  # of the training views that is held out
    fewest: PositiveInt  # views held out; with less than four times as many training views none is
    most: PositiveInt  # views held out
    every: PositiveInt  # iterations between checks
    checks: PositiveInt  # in a window, at least
    window: Annotated[float, Field(gt=0, le=0.5)]  # share of the checks at a resolution that is in a window
    gain: PositiveFloat  # dB, the median over held-out views
    tail: PositiveFloat  # iterations after settling, as a share of those before
    slowdown: Annotated[float, Field(gt=0, le=1)]  # of all learning rates at the end

    def hold_out(self, views: list[View]) -> list[View]:
        """The views to hold out, evenly spread."""
        if len(views) < 4 * self.fewest:
            return []
        count = min(max(self.fewest, round(self.share * len(views))), self.most, len(views) // 4)
        return [views[int((i + 0.5) * len(views) / count)] for i in range(count)]

    def latest(self, iterations: int) -> int:
        """The last iteration at which a training of so many iterations settles."""
        return max(1, int(iterations / (1 + self.tail)))

    def windows(self, psnrs: list[list[float]]) -> tuple[np.ndarray, np.ndarray] | None:
        """PSNR (V,) of V views in the last window and in that before; None while there are too few checks (C, V)."""
        size = max(self.checks, math.ceil(self.window * len(psnrs)))
        if len(psnrs) < 2 * size:
            return None
        values = np.array(psnrs)
        return values[-size:].mean(axis=0), values[-2 * size : -size].mean(axis=0)


class Settling:
    """Decides by a rule when a training goes on to more pixels, settles and ends; slows the optimisers down at last."""

    def __init__(self, rule: SettlingRule, method: Method, context: Context) -> None:
        self.rule, self.method, self.context = rule, method, context
        self._scale = context.curriculum.scale
        self._psnrs: list[list[float]] = []  # of the checks at this resolution, by view
        self._best_scale, self._best_psnrs = 0, list[float]()  # of the resolutions before, at its end; 0: none
        self._no_better = 0  # resolutions in a row since then

    def state_dict(self) -> dict[str, Any]:
        """The state of the decision."""
        names = ("_scale", "_psnrs", "_best_scale", "_best_psnrs", "_no_better")
        return {name.strip("_"): getattr(self, name) for name in names}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore a state from `state_dict`, after that of the context, whose curriculum knows when it settled."""
        for name, value in saved.items():
            setattr(self, f"_{name}", list(value) if isinstance(value, list) else value)
        if self.context.curriculum.settled_at:
            self._stop_growth()

    def reached(self, iteration: int, loss: float) -> bool:
        """Note the end of an iteration's forward pass; True from the iteration on at which training may end."""
        curriculum = self.context.curriculum
        if not curriculum.settled_at:
            scale = self._settles(iteration)
            if scale is None:
                return False
            curriculum.settle(scale)
            self._stop_growth()
        length = max(1, round(self.rule.tail * curriculum.settled_at))
        progress = min(1.0, (iteration - curriculum.settled_at) / length)
        for model in self.method.models().values():
            model.optimizer.slowdown = self.rule.slowdown**progress
        return progress == 1.0

    def _stop_growth(self) -> None:
        for model in self.method.models().values():
            model.stop_growth(self.context.curriculum.settled_at)

    def _settles(self, iteration: int) -> int | None:
        """The scale at which the training settles now; None if it does not."""
        rule, curriculum = self.rule, self.context.curriculum
        if iteration >= rule.latest(self.context.budget.iterations):
            return 1
        if iteration % rule.every or not curriculum.held:
            return None
        if curriculum.scale != self._scale:  # by the schedule
            self._leave_resolution()
        self._psnrs.append(self._held_out_psnrs())
        windows = rule.windows(self._psnrs)
        if windows is None or float(np.median(windows[0] - windows[1])) >= rule.gain:
            return None
        is_last = curriculum.is_at_full_resolution or self._no_better >= IN_A_ROW - 1
        if is_last and not self._is_best(windows[0]):
            return self._best_scale
        if curriculum.is_at_full_resolution:
            return curriculum.scale
        curriculum.advance()
        self._leave_resolution()
        return None

    def _is_best(self, psnrs: np.ndarray) -> bool:
        """Whether held-out views (V,) are better than with the best resolution so far."""
        return not self._best_scale or float(np.median(psnrs - self._best_psnrs)) >= self.rule.gain

    def _leave_resolution(self) -> None:
        """Note what the resolution until now has reached, and begin with the curriculum's."""
        if self._psnrs:
            reached = np.mean(self._psnrs[-self.rule.checks :], axis=0)
            if self._is_best(reached):
                self._best_scale, self._best_psnrs, self._no_better = self._scale, reached.tolist(), 0
            else:
                self._no_better += 1
        self._scale, self._psnrs = self.context.curriculum.scale, []

    @torch.no_grad()
    def _held_out_psnrs(self) -> list[float]:
        """PSNR of the held-out views over valid pixels, at full resolution, dB."""
        values = []
        for view in self.context.curriculum.held:
            image = self.method.render(view.camera).image
            squares = np.square(image.cpu().numpy() - view.thermal)
            mse = float((squares if view.valid is None else squares[view.valid]).mean(dtype=np.float64))
            values.append(-10 * math.log10(max(mse, MIN_MSE)))
        return values

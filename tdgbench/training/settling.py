"""The end of a training by held-out views: they stop getting better, are trained on as well, and rates fall."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import torch
from pydantic import Field, NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt

from tdgbench.scenes import View

if TYPE_CHECKING:
    from tdgbench.training.method import Context, Method

MIN_MSE = 1e-10


@dataclass(frozen=True)
class SettlingRule:
    """Training settles once the mean PSNR of held-out training views has not risen by `gain` for `patience` checks.

    From then on the held-out views are trained on as well, and all learning rates fall log-linearly, for a while.
    A training that never settles does the same at its end.
    """

    share: Annotated[float, Field(gt=0, lt=0.5)]  # of the training views that is held out
    fewest: PositiveInt  # views held out; with less than four times as many training views none is
    every: PositiveInt  # iterations between checks
    patience: PositiveInt  # checks
    gain: NonNegativeFloat  # dB
    after: NonNegativeInt  # earliest check
    tail: PositiveFloat  # iterations after settling, as a share of those before
    slowdown: Annotated[float, Field(gt=0, le=1)]  # of all learning rates at the end

    def hold_out(self, views: list[View]) -> list[View]:
        """The views to hold out, evenly spread."""
        count = max(self.fewest, round(self.share * len(views)))
        if len(views) < 4 * count:
            return []
        return [views[int((i + 0.5) * len(views) / count)] for i in range(count)]

    def latest(self, iterations: int) -> int:
        """The last iteration at which a training of so many iterations settles."""
        return max(1, int(iterations / (1 + self.tail)))


class Settling:
    """Decides by a rule when a training settles and ends; slows the optimisers down in between."""

    def __init__(self, rule: SettlingRule, method: Method, context: Context) -> None:
        self.rule, self.method, self.context = rule, method, context
        self._best = float("-inf")
        self._without = 0
        self._settled = 0  # iteration; 0: not yet

    def state_dict(self) -> dict[str, Any]:
        """The state of the decision."""
        return {"best": self._best, "without": self._without, "settled": self._settled}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Restore a state from `state_dict`."""
        self._best, self._without, self._settled = saved["best"], saved["without"], saved["settled"]
        if self._settled:
            self.context.curriculum.fold_back()

    def reached(self, iteration: int, loss: float) -> bool:
        """Note the end of an iteration's forward pass; True from the iteration on at which training may end."""
        if not self._settled and self._settles(iteration):
            self._settled = iteration
            self.context.curriculum.fold_back()
        if not self._settled:
            return False
        length = max(1, round(self.rule.tail * self._settled))
        progress = min(1.0, (iteration - self._settled) / length)
        for model in self.method.models().values():
            model.optimizer.slowdown = self.rule.slowdown**progress
        return progress == 1.0

    def _settles(self, iteration: int) -> bool:
        rule = self.rule
        if iteration >= rule.latest(self.context.budget.iterations):
            return True
        if iteration <= rule.after or iteration % rule.every or not self.context.curriculum.held:
            return False
        psnr = self._held_out_psnr()
        self._without = 0 if psnr > self._best + rule.gain else self._without + 1
        self._best = max(self._best, psnr)
        return self._without >= rule.patience

    @torch.no_grad()
    def _held_out_psnr(self) -> float:
        """Mean PSNR of the held-out views over their valid pixels, dB."""
        values = []
        for view in map(self.context.curriculum.at_resolution, self.context.curriculum.held):
            squares = np.square(self.method.render(view.camera).image.cpu().numpy() - view.thermal)
            mse = float((squares if view.valid is None else squares[view.valid]).mean(dtype=np.float64))
            values.append(-10 * np.log10(max(mse, MIN_MSE)))
        return float(np.mean(values))

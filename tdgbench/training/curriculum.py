"""What a training shows its models at an iteration: which training views, at which resolution."""

from __future__ import annotations

from typing import Any

from tdgbench.scenes import View
from tdgbench.training.part import Part
from tdgbench.training.pixels import shrunk


class Curriculum(Part):
    """The training views at the current iteration. Without steps and held-out views: all of them, as they are.

    The resolution is that of the schedule, or a higher one that `advance` asked for before.
    """

    def __init__(self, steps: list[tuple[int, int]] | None = None, held: list[View] | None = None) -> None:
        """steps: (last iteration, scale) of each resolution below the full one. held: views to leave out at first."""
        self.steps = steps or []
        self.held = held or []
        self.is_holding = bool(self.held)
        self._names = {view.name for view in self.held}
        self._step = 0  # in use; len(steps): the full resolution
        self.settled_at = 0  # the last iteration before the tail; 0: there is none yet
        self._shrunk: dict[str, View] = {}
        self._iteration = 0
        self._trained = [0] * (len(self.steps) + 1)  # iterations at each step

    def begin(self, iteration: int) -> None:
        """Set the resolution of an iteration (1-based)."""
        self._iteration = iteration
        step = self._step
        while not self.settled_at and step < len(self.steps) and iteration > self.steps[step][0]:
            step += 1
        self._use(step)
        self._trained[self._step] += 1

    def advance(self) -> None:
        """Go on to the next resolution, before the schedule does."""
        self._use(min(self._step + 1, len(self.steps)))

    def settle(self, scale: int) -> None:
        """Train on the views that were held out, too, and at this scale from now on."""
        self.is_holding, self.settled_at = False, max(1, self._iteration)
        self._use([*(one for _, one in self.steps), 1].index(scale))

    def _use(self, step: int) -> None:
        if step != self._step:
            self._step, self._shrunk = step, {}

    @property
    def scale(self) -> int:
        """Images have 1/scale of their width and height now."""
        return self.steps[self._step][1] if self._step < len(self.steps) else 1

    @property
    def is_at_full_resolution(self) -> bool:
        """Whether images have all their pixels now."""
        return self._step == len(self.steps)

    @property
    def iterations(self) -> dict[int, int]:
        """Iterations trained so far by scale, the largest scale first."""
        return dict(zip((*(scale for _, scale in self.steps), 1), self._trained, strict=True))

    def shows(self, view: View) -> bool:
        """Whether a view is trained on."""
        return not (self.is_holding and view.name in self._names)

    def at_resolution(self, view: View) -> View:
        """The view at the current resolution."""
        if self.is_at_full_resolution:
            return view
        if view.name not in self._shrunk:
            self._shrunk[view.name] = shrunk(view, self.scale)
        return self._shrunk[view.name]

    def state_dict(self) -> dict[str, Any]:
        return {
            "step": self._step, "settled_at": self.settled_at, "is_holding": self.is_holding,
            "iteration": self._iteration, "trained": list(self._trained),
        }  # fmt: skip

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        self.settled_at, self.is_holding = saved["settled_at"], saved["is_holding"]
        self._iteration, self._trained = saved["iteration"], list(saved["trained"])
        self._use(saved["step"])

    def report(self) -> dict[str, Any]:
        by_scale = {f"1/{scale}": count for scale, count in self.iterations.items()}
        return {"iterations": by_scale, "held_out": len(self.held), "settled_at": self.settled_at}
